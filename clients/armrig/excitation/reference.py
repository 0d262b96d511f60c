"""References of a run in control: a step, a staircase or a file, and a dither."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np
from armrig_core.control.control_law import ControlLaw
from armrig_core.errors import InputError, ParameterError

from armrig.excitation.binary import telegraph
from armrig.excitation.from_file import reference_from_file
from armrig.excitation.levels import Vector

TIME_CONSTANTS = 5.0
"""Length of each level of a reference, in time constants of the plant without control."""
LEAST_SAMPLES = 150
"""Least length of a level, in samples, if the length is not given."""
_SWITCHING = 0.1
"""Probability that the dither changes its sign at a sample."""
_SHARES = 0.25, 0.5
"""Levels of a step, as shares of the range of r, if they are not given."""


class ReferenceInput(NamedTuple):
    """Reference of a run in control: fields of `armrig.rig.collection.Plan`."""

    make: Callable[[int, float], Vector]
    details: dict[str, Any]
    seconds: float | None


class Profile(NamedTuple):
    """Reference of a run in the law's unit, as a person asked for it."""

    kind: Literal["step", "staircase", "file"]
    low: float
    high: float
    levels: int = 4
    """Number of levels of a staircase, up and down again."""
    dither: float = 0.0
    """Amplitude of a random square wave on the reference, in the unit of r."""
    seed: int = 1
    file: str = ""
    """Path of a file; "" for the other kinds."""


def level_s(law: ControlLaw) -> float | None:
    """Return a length of one level, in s, in which the plant settles; None without a monitor.

    The length is five time constants of the plant and its dead time. It is at least 150 samples,
    and at least twice the prelude.
    """
    if (monitor := law.monitor) is None:
        return None
    sizes = np.abs(np.linalg.eigvals(np.array(monitor.A)))
    Ts, slowest = law.Ts_us / 1e6, float(sizes[sizes < 1 - 1e-9].max(initial=0.0))
    time_constant = -Ts / np.log(slowest) if slowest > 0 else Ts
    settled = TIME_CONSTANTS * time_constant + monitor.input_delay * Ts
    return max(LEAST_SAMPLES * Ts, 2 * monitor.prelude * Ts, float(settled))


def profile_of(
    law: ControlLaw,
    text: str,
    *,
    low: float | None = None,
    high: float | None = None,
    levels: int = 4,
    dither: float = 0.0,
    seed: int = 1,
) -> Profile:
    """Return the reference that `text` names: step, staircase, or the path of a file.

    Without levels, a step goes from a quarter to the half of the law's range.

    Raises
    ------
    InputError
        The levels are outside the law's range or in falling order, or levels and a file are given.
    """
    r = law.reference
    if not (np.isfinite(dither) and dither >= 0):
        raise ParameterError("dither", f"{dither:g}", f"must be 0 or more, in {r.unit or 'r'}")
    if text not in ("step", "staircase"):
        if low is not None or high is not None:
            raise InputError(f"--low and --high with the file {text}: the file has the levels")
        return Profile("file", r.low, r.high, levels, dither, seed, text)
    default = [r.low + share * (r.high - r.low) for share in _SHARES]
    low_r, high_r = (x if y is None else y for x, y in zip(default, (low, high), strict=True))
    if not low_r < high_r:
        raise ParameterError(
            "high", f"{high_r:g} {r.unit}", f"must be above the lowest level, {low_r:g} {r.unit}"
        )
    law.check_reference([low_r - dither, high_r + dither])
    return Profile(
        "staircase" if text == "staircase" else "step", low_r, high_r, levels, dither, seed
    )


def reference_input(
    law: ControlLaw, profile: Profile, seconds: float | None = None
) -> ReferenceInput:
    """Return a profile as the input of a run; by default, each level has the length of `level_s`.

    Raises InputError if a file has a length, or a law without a monitor has none.
    """
    unit = law.reference.unit
    if profile.file:
        if seconds is not None:
            raise ParameterError("seconds", f"{seconds:g}", "a file has its own length")
        reference_of(profile, 0, law.Ts_us / 1e6, unit)  # a wrong file is refused here
    elif seconds is None:
        of_level = level_s(law)
        if of_level is None:
            raise ParameterError("seconds", "is missing", "the law has no model of the plant")
        seconds = of_level * (2 if profile.kind == "step" else 2 * profile.levels - 1)
    details: dict[str, Any] = {"reference": profile.kind}
    details |= {"low": profile.low, "high": profile.high}
    details |= {"levels": profile.levels} if profile.kind == "staircase" else {}
    details |= {"dither": profile.dither, "seed": profile.seed} if profile.dither else {}
    details |= {"file": profile.file.rpartition("/")[2]} if profile.file else {}
    return ReferenceInput(lambda N, Ts: reference_of(profile, N, Ts, unit), details, seconds)


def reference_of(profile: Profile, N: int, Ts: float, unit: str, at: float | None = None) -> Vector:
    """Return the reference (N,) of a profile; a file determines its own length.

    Parameters
    ----------
    profile : Profile
        Kind, levels and dither.
    N : int
        Length in samples.
    Ts : float
        Sampling time, in s.
    unit : str
        Unit of r, which a file may name.
    at : float, optional
        Time of the step, in s; the half of the run by default.

    Examples
    --------
    >>> from armrig.excitation.reference import Profile, reference_of
    >>> reference_of(Profile("step", 2.0, 4.0), 4, 0.01, "rad/s")
    array([2., 2., 4., 4.])
    >>> reference_of(Profile("staircase", 1.0, 3.0, levels=2), 6, 0.01, "rad/s")
    array([1., 1., 3., 3., 1., 1.])
    """
    low, high = profile.low, profile.high
    if profile.file:
        r = reference_from_file(profile.file, Ts, unit)
    elif profile.kind == "step":
        first = N // 2 if at is None else round(at / Ts)
        r = np.where(np.arange(N) < first, low, high).astype(np.float64)
    else:
        up = np.linspace(low, high, profile.levels)
        stairs = np.append(up, up[-2::-1])
        r = stairs[np.arange(N) * stairs.size // N]
    if profile.dither:
        r = r + profile.dither * (2 * telegraph(r.size, _SWITCHING, 0.0, 1.0, profile.seed) - 1)
    return np.asarray(r)
