"""Plan of a run: the input of a request, checked, rehearsed, and converted for loop and recording.

The input may have millions of samples. It is therefore decoded and converted in blocks.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator
from datetime import datetime, timedelta, timezone
from typing import NamedTuple

import msgspec
import numpy as np
from armrig_core.commands.codes import RefusalCode
from armrig_core.commands.commands import (
    MOST_REFERENCES,
    MOST_SAMPLES,
    ControlOptions,
    Refused,
    Rehearsal,
    RunOptions,
    Volts,
    build_refusal,
    check_details,
    decode,
)
from armrig_core.control.control_law import ControlLaw
from armrig_core.errors import InputError, OperationError
from armrig_core.rig.description import Description
from armrig_core.rig.volts import codes_of
from msgspec import UNSET, UnsetType
from msgspec.structs import replace
from numpy.typing import ArrayLike, NDArray

from armrig_daemon.config import Config, Limits

_PIECE_BYTES = 1 << 20
_BLOCK_SAMPLES = 1 << 16
_VOLTAGES = msgspec.json.Decoder(list[Volts])
_NUMBERS = msgspec.json.Decoder(list[float])


class RunPlan(NamedTuple):
    """A run that may begin."""

    options: RunOptions
    samples: int
    source: bytes
    """One u16, little-endian, for each sample; in control, the reference as one float64 each."""
    text: bytes
    """Input or reference as text for the recording: a heading, then one number per line."""
    text_sha256: str
    rehearsal: Rehearsal | None
    """Response of the model to the input; None for a rig without a model."""
    zone: timezone
    """Time zone of this host at the time of the plan."""
    law: ControlLaw | UnsetType | None = UNSET
    """Law of a run in control; None if the client sets each voltage, and unset for other runs."""
    r_range: tuple[float, float] = (0.0, 0.0)
    """Least and largest value of the reference of a law."""


class _UndecodedRun(RunOptions, frozen=True, kw_only=True):
    """Command `run` whose input is not decoded yet."""

    u: msgspec.Raw


class _UndecodedControl(ControlOptions, frozen=True, kw_only=True):
    """Command `control` whose reference is not decoded yet."""

    reference: msgspec.Raw


def decode_run(payload: bytes | bytearray) -> tuple[RunOptions, NDArray[np.float64]]:
    """Return the options and the input (N,), in V, of a command `run`.

    Raises InputError if the payload is not allowed, as `armrig_core.commands.commands.parse` does.
    """
    request = decode(RunOptions.name, payload, _UndecodedRun)
    check_details(request.details)
    return options_of(request), _vector("run", "u", request.u, _VOLTAGES, MOST_SAMPLES)


def decode_control(
    payload: bytes | bytearray,
) -> tuple[ControlOptions, NDArray[np.float64]]:
    """Return the command `control` without its reference, and the reference (N,).

    Raises InputError as `decode_run` does.
    """
    request = decode(ControlOptions.name, payload, _UndecodedControl)
    check_details(request.details)
    r = _vector("control", "reference", request.reference, _NUMBERS, MOST_REFERENCES)
    return request, r


def _vector(
    command: str, key: str, text: msgspec.Raw, kind: msgspec.json.Decoder[list[float]], most: int
) -> NDArray[np.float64]:
    """Return the numbers of a command's array (N,), N at most `most`."""
    blocks = [*_blocks_of(command, key, memoryview(text), kind)]
    values = np.concatenate([np.zeros(0), *blocks])
    if not 1 <= values.size <= most:
        limit = f"<= {most}" if values.size else ">= 1"
        raise InputError(f"{command}: Expected `array` of length {limit} - at `$.{key}`")
    return values


def options_of(request: RunOptions) -> RunOptions:
    """Return a request without its input."""
    return RunOptions(**{name: getattr(request, name) for name in RunOptions.__struct_fields__})


def _blocks_of(
    command: str, key: str, text: memoryview, kind: msgspec.json.Decoder[list[float]]
) -> Iterator[NDArray[np.float64]]:
    """Yield the numbers of a JSON array in pieces."""
    begin = 0
    while begin < len(text):
        end = begin + _PIECE_BYTES
        if end < len(text):
            while end < len(text) and text[end] != ord(","):
                end += 1
        piece = bytes(text[begin:end]).strip()
        piece = b"[" * (begin > 0) + piece + b"]" * (end < len(text))
        try:
            yield np.array(kind.decode(piece), dtype=np.float64)
        except msgspec.DecodeError as err:
            where = str(err).replace("`$", f"`$.{key}")
            raise InputError(f"{command}: {where}") from err
        begin = end + 1


def make_plan(
    options: RunOptions,
    u: ArrayLike,
    Ts: float,
    config: Config,
    description: Description,
    start_rad: float | None = None,
) -> RunPlan:
    """Return the plan of a run.

    `u` is the input (N,) in V, `Ts` the sampling time of the lease in s, and `start_rad` the angle
    of the turning shaft in rad.

    Raises InputError if a voltage or the rehearsal is outside the limits.
    """
    volts = check_voltages(u, config.limits, description.input.rest_v)
    rehearsal = config.rehearsal(volts, Ts, description, start_rad)
    source = b"".join(map(codes_of, _blocks(volts)))
    return _build_plan(options, source, one_a_line(_blocks(volts)), volts.size, rehearsal)


def make_control_plan(
    request: ControlOptions,
    r: ArrayLike,
    Ts: float,
    config: Config,
    description: Description,
    start_rad: float | None = None,
) -> RunPlan:
    """Return the plan of a run in control.

    `r` is the reference (N,) in the unit of the law; the other arguments are those of `make_plan`.

    Raises InputError if the law is not one for this rig and this sampling time, the reference or
    the rehearsal is outside the limits, or the closed loop is unstable.
    """
    law, limits = request.law, config.limits
    reference = np.asarray(r, dtype=np.float64)
    if law is None:
        # The lease of `set` is shorter than any dead-man. No model knows the client's voltages.
        options = replace(options_of(request), dead_man=None)
        source, text = reference.astype("<f8").tobytes(), one_a_line(_blocks(reference), "r")
        plan = _build_plan(options, source, text, reference.size, None)
        return plan._replace(law=None)
    law.check_rig(description, round(Ts * 1e6), limits.u_min_v, limits.u_max_v)
    law.check_reference(reference.tolist())
    if (doubt := law.monitor_doubt(description)) and not request.unmonitored:
        raise InputError(
            f"{doubt}: design the law by `armrig design`, or give model= to "
            "armrig.control.control_law; unmonitored=True (--unmonitored) allows this law"
        )
    rehearsal = config.control_rehearsal(
        law, reference, description, start_rad, unstable=request.unstable
    )
    source = reference.astype("<f8").tobytes()
    text = one_a_line(_blocks(reference), f"r_{law.reference.name}")
    plan = _build_plan(options_of(request), source, text, reference.size, rehearsal)
    r_range = float(reference.min()), float(reference.max())
    return plan._replace(law=law, r_range=r_range)


def _build_plan(
    options: RunOptions, source: bytes, text: bytes, samples: int, rehearsal: Rehearsal | None
) -> RunPlan:
    return RunPlan(
        options=options,
        samples=samples,
        source=source,
        text=text,
        text_sha256=hashlib.sha256(text).hexdigest(),
        rehearsal=rehearsal,
        zone=timezone(datetime.now().astimezone().utcoffset() or timedelta()),
    )


def _blocks(volts: NDArray[np.float64]) -> Iterator[list[float]]:
    for begin in range(0, volts.size, _BLOCK_SAMPLES):
        yield volts[begin : begin + _BLOCK_SAMPLES].tolist()


def plan_of(
    payload: Callable[[], bytes | bytearray],
    Ts: float,
    config: Config,
    description: Description,
    start_rad: float | None = None,
    tell: Callable[[RunOptions], object] = lambda options: None,
    command: str = RunOptions.name,
) -> RunPlan | Refused:
    """Return the plan of a command `run` or `control`, or the refusal; see `make_plan`.

    `command` is the name of the command. `payload` returns the command, which may have 80 MB and is
    then no longer needed. `tell` is called with the options before the rehearsal, which may take
    long.
    """
    try:
        if command == ControlOptions.name:
            request, r = decode_control(payload())
            tell(options_of(request))
            return make_control_plan(request, r, Ts, config, description, start_rad)
        options, u = decode_run(payload())
        tell(options)
        return make_plan(options, u, Ts, config, description, start_rad)
    except (ValueError, OperationError) as err:
        return build_refusal(RefusalCode.NOT_ALLOWED, str(err))
    except Exception as err:
        return build_refusal(RefusalCode.INTERNAL, f"{command}: {err!r}")


def one_a_line(blocks: Iterable[list[float]], heading: str = "u_v") -> bytes:
    """Return an input as text for the recording: a heading, then a number per line."""
    # msgspec takes a tenth of the time of repr.
    texts = (msgspec.json.encode(block)[1:-1].replace(b",", b"\n") for block in blocks)
    return heading.encode() + b"\n" + b"\n".join(texts) + b"\n"


def check_voltages(u: ArrayLike, limits: Limits, rest_v: float = 0.0) -> NDArray[np.float64]:
    """Return the voltages of an experiment, (N,) in V; the first step is from `rest_v`.

    Raises InputError if a voltage is outside the limits, or a step is too large; the message names
    the first index.
    """
    volts = np.asarray(u, dtype=np.float64)
    low, high, slew = limits.u_min_v, limits.u_max_v, limits.slew_v
    outside = ~((volts >= low) & (volts <= high))
    if outside.any():
        i = int(np.argmax(outside))
        raise InputError(f"u[{i}]={volts[i]:.4g} V is outside {low:.4g} … {high:.4g} V")
    if not slew:
        return volts
    steps = np.abs(np.diff(volts, prepend=rest_v))
    # The tolerance allows for the rounding error in the difference of two decimal numbers.
    far = steps > slew * (1 + 1e-9)
    if far.any():
        i = int(np.argmax(far))
        raise InputError(f"u[{i}] steps by {steps[i]:.4g} V: at most {slew:.4g} V in a sample")
    return volts
