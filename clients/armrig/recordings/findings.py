"""Checks of a recording's data, and their findings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import ceil
from typing import TYPE_CHECKING

import numpy as np
from armrig_core.commands.codes import OutcomeCode
from armrig_core.commands.commands import UNTIL
from armrig_protocol.messages import Flag

from armrig.data.finding import FEW_SAMPLES, Finding, few_samples, good, unusable, warning
from armrig.numerics.quantities import digits, error, microseconds, percent, plural
from armrig.numerics.step_times import ramp_lag
from armrig.numerics.stretches import longest, stretches
from armrig.recordings.jitter import angle_of_jitter, sampling_statistics

if TYPE_CHECKING:
    from armrig.data.dataset import Dataset
    from armrig.recordings.recording import Recording


LEAST_RATIO, NO_RATIO = 3.0, 0.3
"""Signal-to-noise ratios. Below the first, a recording of 30 s determines the inertias with errors
of some per cent; below the second, it does not determine them."""
MOST_HIDDEN = 0.15
"""Largest share of samples without an angle that a dead band of an eighth of a turn explains."""
MOST_MISSING = 0.01
TOO_FEW = 20
"""Least number of samples for an estimate of a model of this rig."""
LONGEST_UNSEEN_S = 1.0
"""Longest time that a turning chassis spends in its dead band at any voltage, in s."""
_MAX_REST_STEPS = 6  # largest range of readings at rest, in steps of the converter
_MARGIN_RAD = 1.5  # from the dead band to the beginning of the next step
_EARLIEST_STEP_S = 0.5
_MIN_LINE_SAMPLES = 8
_WIDE, _LONGER = 0.7, 4  # share of the input's range from which more time is advised
_MIN_SPEED_RAD_S = 0.05  # of a chassis that turns before the step


def early_end(r: Recording) -> str:
    """Return why a run ended before the end of its input; "" if it did not."""
    if r.outcome is None:
        return "the reason is not recorded"
    normal = r.outcome.code in (OutcomeCode.COMPLETE, OutcomeCode.CONTINUED)
    normal |= r.outcome.code == OutcomeCode.STOPPED and UNTIL in r.manifest.details
    return "" if normal else r.outcome.outcome


def check_run(r: Recording) -> Iterator[Finding]:
    """Check how the run ended, the number of samples that arrived, and that the input changes."""
    count, u = r.samples.size, r.u[np.isfinite(r.u)]
    instants = ceil(count / r.manifest.every)
    if r.cut_off:
        yield warning("run", f"the file is cut off: it contains {r.N * r.Ts:g} of {r.asked_s:g} s")
    elif r.truncated:
        yield warning("run", f"the file is damaged: {r.damage}")
    elif why := early_end(r):
        yield warning("run", f"the run ended early: {why}")
    if instants < TOO_FEW:
        text = plural(instants, "sample is", "samples are")
        yield unusable("samples", f"{text} too few; record {FEW_SAMPLES} or more")
    else:
        yield from few_samples(u.size // r.manifest.every)
        yield _arrival(r)
    if not u.size or np.ptp(u) == 0:
        yield unusable("input", "the input never changes; use an input that switches")
    else:
        unit = r.description.input.unit if r.is_imported else "V"
        yield good("input", f"{digits(u.min(), 3)} to {digits(u.max(), 3)} {unit}".rstrip())


def _arrival(r: Recording) -> Finding:
    if not r.missing:
        return good("samples", f"all {plural(r.N, 'sample')} arrived")
    many, text = r.missing > MOST_MISSING * r.N, f"{r.missing} of {r.N} samples are missing"
    remedy = ": `armrig info` and `armrig doctor` show why" if many else " and marked missing"
    return (warning if many else good)("samples", text + remedy)


def check_first(r: Recording) -> Finding:
    """Check the share of samples without the first channel, and the longest time without it."""
    count, first, name = r.samples.size, r.description.channels[0], r.first
    about, body = "angle" if first.turns else "output", first.body or "shaft"
    if not r.valid.any():
        lost = "the value is out of the converter's range"
        if first.turns:
            lost = f"the wiper is in the dead band (turn the {body} by hand)"
        text = f"no sample of {count} shows {name}: a wire is broken, or {lost}"
        return unusable(about, f"{text}; look at `armrig watch`")
    if not first.turns:
        if not r.hidden:
            return good(about, f"{name} is inside the converter's range in all samples")
        text = f"{name} was at an end of the converter's range in {r.hidden} of {count} samples"
        return warning(about, f"{text}, which count as missing")
    share, unseen = r.hidden / count, longest(r.present & ~r.valid) * r.Ts
    if unseen > LONGEST_UNSEEN_S:
        text = f"{name} is hidden for {unseen:.1f} s without a break: the {body} was in the dead "
        return warning(about, f"{text}band, or a wire is loose")
    text = f"{name} is hidden in {percent(100 * share)} of the samples (dead band, and the sample "
    if share > MOST_HIDDEN:
        return warning(about, f"{text}after it): too many for a dead band; check the potentiometer")
    return good(about, f"{text}after it)")


def check_second(r: Recording) -> Iterator[Finding]:
    """Check that the second channel is not at an end of its track, or rests in a greybox run."""
    for second in r.description.channels[1:]:
        clipped = int(np.count_nonzero(r.samples["flags"] & Flag.ADC1_RAIL))
        if r.manifest.kind == "greybox":
            yield _check_removed_arm(r, second.name)
        elif clipped:
            about, end = ("arm", "track") if second.body else ("output", "range")
            text = f"{second.name} was at the end of its {end} in {clipped} of {r.samples.size} "
            text += f"samples. These samples count as missing in {second.name}; "
            yield warning(about, f"{text}{r.first} is not affected")


def _check_removed_arm(r: Recording, name: str) -> Finding:
    moved, rehearsed = second_moves(r), r.manifest.rehearsal
    configured = rehearsed is not None and rehearsed.deflects
    if not (moved or configured):
        return good("arm", "the rotating part is removed")
    parts = ["remove the rotating part (handout, figure 6)"] * moved
    remedy = " and ".join([*parts, *["set [arm] removed = true"] * configured])
    clause = ", and the daemon's configuration has an arm" * configured
    grade = unusable if moved and configured else warning
    return grade("arm", f"{name} {'moves' if moved else 'rests'}{clause}: {remedy}")


def second_moves(r: Recording) -> bool:
    """Return True if the second channel moved by more than its noise, as an attached arm does."""
    if len(r.description.channels) < 2:
        return False
    name = r.description.channels[1].counts_field
    counts = r.samples[name][(r.samples["flags"] & Flag.ADC1_RAIL) == 0]
    return counts.size > 0 and int(np.ptp(counts)) > _MAX_REST_STEPS * converter_step(r)


def check_signal(r: Recording, signal: float, noise: float, step: float) -> Iterator[Finding]:
    """Compare the signal in the first channel with the noise and the step of the converter."""
    first = r.description.channels[0]
    steps = plural(float(digits(noise / step, 2)), "step")
    ratio, steady = signal / noise, "a steady rotation" if first.turns else "its mean"
    text = f"signal to noise {digits(ratio, 2)} to 1: {first.name} deviates from {steady} by "
    text += f"{error(signal, first.unit)} rms, and the noise, which an ARX model does not explain, "
    text += f"is {error(noise, first.unit)} ({steps} of the converter)"
    if not ratio < LEAST_RATIO:
        yield good("signal", text)
        return
    grade, why = (unusable, "the signal is only noise: ") if ratio < NO_RATIO else (warning, "")
    remedy = "use levels with a larger difference"
    if np.ptp(r.u[np.isfinite(r.u)]) >= _WIDE * r.description.input.u_max_v:
        remedy = f"record longer, such as {digits(_LONGER * r.N * r.Ts, 2)} s"
    yield grade("signal", f"{text}; {why}{remedy}")


def check_timing(r: Recording, data: Dataset, noise: float) -> Iterator[Finding]:
    """Compare the effect of jitter on the first channel with its noise, in the same unit."""
    timing = sampling_statistics(r)
    if not np.isfinite(timing.std_us):
        return
    angle = angle_of_jitter(timing, data)
    text = f"the sampling interval varies by {microseconds(timing.std_us)}"
    if angle > noise:
        text += f" and moves {r.first} by {error(angle, data.unit)}, more than its noise: let the "
        yield warning("timing", f"{text}device pace the samples (--pacing scheduled)")
    else:
        yield good("timing", f"{text}, too little to affect {r.first}")


def check_turns(r: Recording) -> Iterator[Finding]:
    """Check that the number of turns is known everywhere."""
    if r.turns_unknown:
        at = ", ".join(f"{r.t[i]:.2f}" for i in r.turns_unknown[:3])
        at += ", …" if len(r.turns_unknown) > 3 else ""
        text = f"the number of turns is unknown from {at} s on, after too many missing samples in "
        yield warning("turns", f"{text}a row (or Ts is too long): the data are divided there")


def converter_step(r: Recording) -> int:
    """Return the step of the converter in counts; the full range has 65536 counts."""
    bits = r.manifest.device.get("adc_bits")
    return 1 << (16 - bits) if isinstance(bits, int) and 0 < bits <= 16 else 1


def check_step(r: Recording) -> Finding | None:
    """Return a warning if the dead band hides the rise of a step of a turning shaft, else None.

    Its numbers are times in s. `begins_s` and `ends_s`, after the step, are those of the last
    sample before the hidden interval and of the first sample after it. A step at `at_s`, in a run
    of `length_s`, shows its rise if nobody turns the chassis until then; without these two numbers
    the chassis rests before the step.

    The duration of the rise is the lag of the angle relative to its final straight line, the
    equivalent time of `armrig.numerics.step_times`, which needs no samples of the rise.
    """
    edges = np.flatnonzero(np.diff(r.u) != 0)
    if r.manifest.kind != "step" or edges.size != 1 or not r.description.channels[0].turns:
        return None
    y = r[r.first]
    at = int(edges[0]) + 1
    k, valid = np.arange(r.N) - at, r.valid
    before, after = valid & (k < 0) & (k > -at // 2 - 2), valid & (k > (r.N - at) // 2)
    if min(np.count_nonzero(before), np.count_nonzero(after)) < _MIN_LINE_SAMPLES:
        return None
    v0, y0 = np.polyfit(r.Ts * k[before], y[before], 1)
    since = y - y0 - v0 * r.Ts * k
    v1 = v0 + float(np.polyfit(r.Ts * k[after], since[after], 1)[0])
    lag = ramp_lag(np.asarray(r.Ts * k[after], np.float64), since[after])
    if np.isnan(lag):
        return None
    gaps = [g for g in stretches(~valid) if g.stop > at + 1 and (g.start - at) * r.Ts < lag]
    gap = max(gaps, key=lambda g: g.stop - g.start, default=None)
    if gap is None or gap.stop - gap.start < 2 or gap.stop >= r.N:
        return None
    begins_s, ends_s = (gap.start - 1 - at) * r.Ts, (gap.stop - at) * r.Ts
    numbers = {"begins_s": begins_s, "ends_s": ends_s}
    text = f"{r.first} is hidden from {1e3 * begins_s:.0f} to {1e3 * ends_s:.0f} ms after the step,"
    text += " on the rise: the 63 % time is inaccurate. Repeat with "
    if abs(v0) <= _MIN_SPEED_RAD_S:
        body = r.description.channels[0].body or "shaft"
        return warning("step", f"{text}the {body} turned by hand by a quarter turn", **numbers)
    # The chassis turns from where this run ended to `_MARGIN_RAD` after the dead band.
    begin = y[gap.stop] + np.copysign(_MARGIN_RAD, v0)
    way = (begin - y[valid][-1] - v1 * lag) % (2 * np.pi)
    later = way / v0 if v0 > 0 else (way - 2 * np.pi) / v0
    later = later + 2 * np.pi / abs(v0) if later < _EARLIEST_STEP_S else later
    numbers["at_s"] = np.ceil(10 * later) / 10
    numbers["length_s"] = np.ceil(numbers["at_s"] + (r.N - at) * r.Ts)
    text += f"`{step_options(numbers)}`, which steps away from the dead band"
    return warning("step", text, **numbers)


def step_options(numbers: Mapping[str, float]) -> str:
    """Return the options of `armrig collect step` that repeat a hidden step; "" if none do."""
    return "--at {at_s:g} --seconds {length_s:g}".format(**numbers) if "at_s" in numbers else ""
