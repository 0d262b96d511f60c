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
    MOST_SAMPLES,
    Refused,
    Rehearsal,
    RunOptions,
    Volts,
    check_details,
    decode,
    refused,
)
from armrig_core.errors import InputError, OperationError
from armrig_core.rig.description import Description
from armrig_core.rig.volts import codes_of
from numpy.typing import ArrayLike, NDArray

from armrig_daemon.config import Config, Limits

_PIECE_BYTES = 1 << 20
_BLOCK_SAMPLES = 1 << 16
_PIECE = msgspec.json.Decoder(list[Volts])


class Plan(NamedTuple):
    """A run that may begin."""

    options: RunOptions
    samples: int
    codes: bytes
    """One u16, little-endian, for each sample."""
    text: bytes
    """Input as text for the recording: a heading, then one voltage per line."""
    text_sha256: str
    rehearsal: Rehearsal | None
    """Response of the model to the input; None for a rig without a model."""
    zone: timezone
    """Time zone of this host at the time of the plan."""


class _Request(RunOptions, frozen=True, kw_only=True):
    """Command `run` whose input is not decoded yet."""

    u: msgspec.Raw


def decode_run(payload: bytes | bytearray) -> tuple[RunOptions, NDArray[np.float64]]:
    """Return the options and the input (N,), in V, of a command `run`.

    Raises InputError if the payload is not allowed, as `armrig_core.commands.commands.parse` does.
    """
    request = decode(RunOptions.name, payload, _Request)
    check_details(request.details)
    blocks = [*_voltages(memoryview(request.u))]
    u = np.concatenate([np.zeros(0), *blocks])
    if not 1 <= u.size <= MOST_SAMPLES:
        limit = f"<= {MOST_SAMPLES}" if u.size else ">= 1"
        raise InputError(f"run: Expected `array` of length {limit} - at `$.u`")
    return options_of(request), u


def options_of(request: RunOptions) -> RunOptions:
    """Return a request without its input."""
    return RunOptions(**{name: getattr(request, name) for name in RunOptions.__struct_fields__})


def _voltages(text: memoryview) -> Iterator[NDArray[np.float64]]:
    """Yield the numbers of a JSON array, in V, in pieces."""
    begin = 0
    while begin < len(text):
        end = begin + _PIECE_BYTES
        if end < len(text):
            while end < len(text) and text[end] != ord(","):
                end += 1
        piece = bytes(text[begin:end]).strip()
        piece = b"[" * (begin > 0) + piece + b"]" * (end < len(text))
        try:
            yield np.array(_PIECE.decode(piece), dtype=np.float64)
        except msgspec.DecodeError as err:
            raise InputError(f"run: {str(err).replace('`$', '`$.u')}") from err
        begin = end + 1


def make_plan(
    options: RunOptions,
    u: ArrayLike,
    Ts: float,
    config: Config,
    description: Description,
    start_rad: float | None = None,
) -> Plan:
    """Return the plan of a run.

    `u` is the input (N,) in V, `Ts` the sampling time of the lease in s, and `start_rad` the angle
    of the turning shaft in rad.

    Raises InputError if a voltage or the rehearsal is outside the limits.
    """
    volts = checked(u, config.limits, description.input.rest_v)
    rehearsal = config.rehearsal(volts, Ts, description, start_rad)
    text = one_a_line(_blocks(volts))
    return Plan(
        options=options,
        samples=volts.size,
        codes=b"".join(map(codes_of, _blocks(volts))),
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
) -> Plan | Refused:
    """Return the plan of a command `run`, or the refusal; the arguments are those of `make_plan`.

    `payload` returns the command, which may have 80 MB and is then no longer needed. `tell` is
    called with the options before the rehearsal, which may take long.
    """
    try:
        options, u = decode_run(payload())
        tell(options)
        return make_plan(options, u, Ts, config, description, start_rad)
    except (ValueError, OperationError) as err:
        return refused(RefusalCode.NOT_ALLOWED, str(err))
    except Exception as err:
        return refused(RefusalCode.INTERNAL, f"run: {err!r}")


def one_a_line(blocks: Iterable[list[float]]) -> bytes:
    """Return an input as text for the recording: a heading, then a voltage per line."""
    # msgspec takes a tenth of the time of repr.
    texts = (msgspec.json.encode(block)[1:-1].replace(b",", b"\n") for block in blocks)
    return b"u_v\n" + b"\n".join(texts) + b"\n"


def checked(u: ArrayLike, limits: Limits, rest_v: float = 0.0) -> NDArray[np.float64]:
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
