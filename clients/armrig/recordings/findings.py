"""What is checked in a recording's data, and what was found."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from armrig_core.codes import OutcomeCode
from armrig_protocol.messages import Flag

from armrig.data.finding import Finding
from armrig.numerics.quantities import error, microseconds, percent
from armrig.numerics.step_times import ramp_lag
from armrig.numerics.stretches import longest, stretches
from armrig.recordings.jitter import angle_of_jitter, sampling_statistics

if TYPE_CHECKING:
    from armrig.data.dataset import Dataset
    from armrig.recordings.recording import Recording


LEAST_RATIO, NO_RATIO = 3.0, 0.3
"""Signal over noise below which 30 s give inertias to some per cent only, and nothing at all."""
MOST_HIDDEN = 0.15
"""Share of the samples without theta_1 that no dead band, an eighth of a turn at most, makes."""
MOST_MISSING = 0.01
TOO_FEW = 20
"""Samples that no model of this rig is estimated from."""
LONGEST_UNSEEN_S = 1.0
"""A chassis that turns is out of its dead band in less, whatever the voltage."""
_AT_REST = 6  # steps of the converter by which readings of a joint that stands still differ at most
_BEYOND = 1.5  # rad between the dead band and where the next step is to begin
_EARLIEST_S = 0.5
_FEWEST = 8  # samples of a line
_MOVES = 0.05  # rad/s from which on the chassis turns before the step


def _good(about: str, text: str) -> Finding:
    return Finding(level="good", about=about, text=text)


def _warning(about: str, text: str) -> Finding:
    return Finding(level="warning", about=about, text=text)


def _unusable(about: str, text: str) -> Finding:
    return Finding(level="unusable", about=about, text=text)


def check_run(r: Recording) -> Iterator[Finding]:
    """Check how the run ended, and whether the file is whole."""
    if r.cut_off:
        text = f"the file is cut off: it holds {r.N * r.Ts:g} of {r.asked_s:g} s"
        yield _warning("run", text)
    elif r.truncated:
        yield _warning("run", f"the file is not whole: {r.damage}")
    elif r.outcome is None or r.outcome.code != OutcomeCode.COMPLETE:
        why = r.outcome.outcome if r.outcome else "the file does not say why"
        yield _warning("run", f"the run ended early: {why}")


def check_input(r: Recording) -> Iterator[Finding]:
    """Check whether the input moves at all."""
    u = r.u[np.isfinite(r.u)]
    if not u.size or np.ptp(u) == 0:
        text = "the input never changes, so no dynamics show; play one that switches"
        yield _unusable("input", text)
    else:
        yield _good("input", f"{u.min():.3g} to {u.max():.3g} V")


def check_angle(r: Recording) -> Iterator[Finding]:
    """Check how much of theta_1 is hidden, and for how long on end."""
    came = r.samples.size
    if not r.valid.any():
        text = (
            f"no sample of {came} shows theta_1: a wire is broken, or it stands in the dead band; "
        )
        yield _unusable("angle", text + "look at `armrig watch` while you turn the chassis by hand")
        return
    share, unseen = r.hidden / came, longest(r.present & ~r.valid) * r.Ts
    text = f"theta_1 is hidden in {percent(100 * share)} of the samples (dead band, and the one "
    text += "after)"
    if unseen > LONGEST_UNSEEN_S:
        text = f"theta_1 is hidden for {unseen:.1f} s at a stretch: the chassis stood in the dead "
        yield _warning("angle", text + "band, or a wire is loose")
    elif share > MOST_HIDDEN:
        yield _warning("angle", f"{text}: too many for a dead band; check the potentiometer")
    else:
        yield _good("angle", text)


def check_step(r: Recording) -> Iterator[Finding]:
    """Check whether the dead band hides the rise of a step."""
    hidden = hidden_step(r) if r.manifest.experiment.partition("-")[0] == "step" else None
    if hidden is None:
        return
    text = f"theta_1 is hidden from {1e3 * hidden.begins_s:.0f} to {1e3 * hidden.ends_s:.0f} ms "
    text += "after the step, on the rise: the 63 % time is poorly known. Repeat with "
    if np.isfinite(hidden.at_s):
        text += f"`--at {hidden.at_s:g} --seconds {hidden.seconds:g}`, which steps away from the "
        yield _warning("step", f"{text}dead band")
    else:
        yield _warning("step", f"{text}the chassis turned by hand by a quarter turn")


def check_arm(r: Recording) -> Iterator[Finding]:
    """Check alpha, which has no dead band to pass through; without the arm it must rest."""
    if _is_greybox(r):
        yield from _check_removed_arm(r)
        return
    clipped = int(np.count_nonzero(r.samples["flags"] & Flag.ADC1_RAIL))
    if clipped:
        text = f"alpha was at the end of its track in {clipped} of {r.samples.size} samples, which "
        yield _warning("arm", text + "count as missing in alpha; theta_1 is not affected")


def alpha_moves(r: Recording) -> bool:
    """Return whether alpha moved by more than its noise: then the arm was on."""
    counts = r.samples["alpha_counts"][(r.samples["flags"] & Flag.ADC1_RAIL) == 0]
    return counts.size > 0 and int(np.ptp(counts)) > _AT_REST * converter_step(r)


def _check_removed_arm(r: Recording) -> Iterator[Finding]:
    moved = alpha_moves(r)
    rehearsed = r.manifest.rehearsal
    configured_on = rehearsed is not None and rehearsed.alpha_rad > 0
    if moved and configured_on:
        text = "alpha moves, and the daemon was told that the arm is on: take the rotating part "
        yield _unusable("arm", text + "off (handout, figure 6) and set [arm] removed = true")
    elif moved:
        text = "alpha moves, although the rotating part is to be off: see that it is"
        yield _warning("arm", text)
    elif configured_on:
        text = "alpha rests, but the daemon's configuration still has the arm on: set [arm] "
        yield _warning("arm", text + "removed = true, or its rehearsal is of another rig")
    else:
        yield _good("arm", "the rotating part is off")


def check_signal(signal: float, noise: float, step: float) -> Iterator[Finding]:
    """Check what theta_1 does against its noise and the step of the converter, in rad."""
    ratio = signal / noise
    text = f"signal to noise {ratio:.2g} to 1: theta_1 departs from steady turning by "
    text += f"{error(signal, 'rad')} rms, and what its past and u "
    text += f"do not foretell is {error(noise, 'rad')} "
    text += f"({noise / step:.2g} steps of the converter)"
    if ratio < NO_RATIO:
        yield _unusable("signal", f"{text}; nothing but noise: set the levels further apart")
    elif ratio < LEAST_RATIO:
        yield _warning("signal", f"{text}; too quiet: set the levels further apart")
    else:
        yield _good("signal", text)


def check_samples(r: Recording) -> Iterator[Finding]:
    """Check how many samples came."""
    came = r.samples.size
    if came < TOO_FEW:
        yield _unusable("samples", f"{came} samples are no data; record {TOO_FEW} or more")
    elif not r.missing:
        yield _good("samples", f"all {r.N} samples came")
    elif r.missing > MOST_MISSING * r.N:
        text = f"{r.missing} of {r.N} samples are missing: `armrig info` and `armrig doctor` "
        yield _warning("samples", f"{text}say why")
    else:
        yield _good("samples", f"{r.missing} of {r.N} samples are missing, and marked so")


def check_timing(r: Recording, data: Dataset, noise: float) -> Iterator[Finding]:
    """Check what the jitter did to theta_1, in rad, against its noise."""
    timing = sampling_statistics(r)
    if not np.isfinite(timing.std_us):
        return
    angle = angle_of_jitter(timing, data)
    text = f"the sampling interval varies by {microseconds(timing.std_us)}"
    if angle > noise:
        text += f", which moves theta_1 by {error(angle, 'rad')}, more than its noise: let the "
        yield _warning("timing", f"{text}device pace the samples (--pacing scheduled)")
    else:
        yield _good("timing", f"{text}, too little to matter")


def check_turns(r: Recording) -> Iterator[Finding]:
    """Check where the number of turns was lost."""
    if r.turns_unknown:
        at = ", ".join(f"{r.t[i]:.2f}" for i in r.turns_unknown[:3])
        more = ", …" if len(r.turns_unknown) > 3 else ""
        text = f"the number of turns is lost at {at}{more} s, where too many samples in a row are "
        text += "missing (or Ts is too long): the data are cut there"
        yield _warning("turns", text)


def _is_greybox(r: Recording) -> bool:
    return r.manifest.experiment.partition("-")[0] == "greybox"


def converter_step(r: Recording) -> int:
    """Return one step of the converter in counts of 65536."""
    bits = r.manifest.device.get("adc_bits")
    return 1 << (16 - bits) if isinstance(bits, int) and 0 < bits <= 16 else 1


@dataclass(frozen=True, slots=True, kw_only=True)
class HiddenStep:
    """Where the rise of a step is not seen."""

    begins_s: float
    """Last sample before the gap, in s from the step."""
    ends_s: float
    """First sample after it, in s from the step."""
    at_s: float
    """When the next run is to step, if nobody turns the chassis meanwhile; NaN where it rests
    before the step, so that no time is better than another."""
    seconds: float
    """Length of that run with as long a time after the step."""


def hidden_step(r: Recording) -> HiddenStep | None:
    """Return what is hidden of the rise, None where all of it is seen, or there is no step.

    The rise is taken to last for the equivalent time (`armrig.numerics.step_times`), by which the
    angle lags the straight line that it ends up on: it needs no sample of the rise.
    """
    edges = np.flatnonzero(np.diff(r.u) != 0)
    if edges.size != 1:
        return None
    at = int(edges[0]) + 1
    k, known = np.arange(r.N) - at, r.valid
    before, after = known & (k < 0) & (k > -at // 2 - 2), known & (k > (r.N - at) // 2)
    if min(np.count_nonzero(before), np.count_nonzero(after)) < _FEWEST:
        return None
    v0, y0 = np.polyfit(r.Ts * k[before], r.theta_1[before], 1)
    since = r.theta_1 - y0 - v0 * r.Ts * k
    v1 = v0 + float(np.polyfit(r.Ts * k[after], since[after], 1)[0])
    behind = ramp_lag(np.asarray(r.Ts * k[after], np.float64), since[after])
    if np.isnan(behind):
        return None
    gaps = [g for g in stretches(~known) if g.stop > at + 1 and (g.start - at) * r.Ts < behind]
    gap = max(gaps, key=lambda g: g.stop - g.start, default=None)
    if gap is None or gap.stop - gap.start < 2 or gap.stop >= r.N:
        return None
    # From where the chassis came to rest, about, on to well beyond the dead band.
    begin = r.theta_1[gap.stop] + np.copysign(_BEYOND, v0)
    way = (begin - r.theta_1[known][-1] - v1 * behind) % (2 * np.pi)
    turns = abs(v0) > _MOVES
    later = way / v0 if v0 > 0 else (way - 2 * np.pi) / v0 if turns else float("nan")
    later = later + 2 * np.pi / abs(v0) if later < _EARLIEST_S else later
    moment = float(np.ceil(10 * later) / 10) if turns else float("nan")
    return HiddenStep(
        begins_s=float((gap.start - 1 - at) * r.Ts),
        ends_s=float((gap.stop - at) * r.Ts),
        at_s=moment,
        seconds=float(np.ceil(moment + (r.N - at) * r.Ts)) if turns else float("nan"),
    )
