"""What is checked in a recording's data, and what was found."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from armrig_protocol.messages import Flag

from armrig.numerics.quantities import error, microseconds, percent
from armrig.numerics.stretches import longest
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """What one check found."""

    level: Literal["good", "warning", "unusable"]
    """Whether it stands in the way of identification."""
    about: str
    """What was checked: run, input, angle, arm, signal, samples, timing or turns."""
    text: str
    """What was found and, where it is not good, what to do."""


def _good(about: str, text: str) -> Finding:
    return Finding(level="good", about=about, text=text)


def _warning(about: str, text: str) -> Finding:
    return Finding(level="warning", about=about, text=text)


def _unusable(about: str, text: str) -> Finding:
    return Finding(level="unusable", about=about, text=text)


def check_run(r: Recording) -> Iterator[Finding]:
    """Check how the run ended, and whether the file is whole."""
    if r.cut_off:
        text = f"the file is cut off: it holds {r.N * r.Ts:g} s of {r.asked_s:g} s"
        yield _warning("run", text)
    elif r.truncated:
        yield _warning("run", f"the file is not whole: {r.damage}")
    elif r.outcome is None or r.outcome.outcome != "complete":
        why = r.outcome.outcome if r.outcome else "nobody wrote down why"
        yield _warning("run", f"the run ended early: {why}")


def check_input(r: Recording) -> Iterator[Finding]:
    """Check whether the input moves at all."""
    u = r.u[np.isfinite(r.u)]
    if not u.size or np.ptp(u) == 0:
        text = "the input never moves: it shows a gain at most; play one that switches"
        yield _unusable("input", text)
    else:
        yield _good("input", f"{u.min():.3g} to {u.max():.3g} V")


def check_angle(r: Recording) -> Iterator[Finding]:
    """Check how much of theta_1 is hidden, and for how long on end."""
    came = r.samples.size
    if not r.valid.any():
        text = f"none of {came} samples shows theta_1: broken wire, or it stands in the dead band; "
        yield _unusable("angle", text + "look at `armrig watch` while you turn the chassis by hand")
        return
    share, unseen = r.hidden / came, longest(r.present & ~r.valid) * r.Ts
    text = f"{percent(100 * share)} of the samples have no theta_1 (dead band, and the one after)"
    if unseen > LONGEST_UNSEEN_S:
        text = f"theta_1 is at a rail for {unseen:.1f} s on end: the chassis stands in the dead "
        yield _warning("angle", text + "band, or a wire is loose")
    elif share > MOST_HIDDEN:
        yield _warning("angle", f"{text}: more than a dead band makes; check the potentiometer")
    else:
        yield _good("angle", text)


def check_arm(r: Recording) -> Iterator[Finding]:
    """Check alpha, which has no dead band to pass through; without the arm it must rest."""
    if _is_greybox(r):
        yield from _check_removed_arm(r)
        return
    clipped = int(np.count_nonzero(r.samples["flags"] & Flag.ADC1_RAIL))
    if clipped:
        text = f"alpha is clipped at a rail in {clipped} of {r.samples.size} samples, which count "
        yield _warning("arm", text + "as missing in alpha; theta_1 is not touched")


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
    text = f"theta_1 moves by {error(signal, 'rad')} rms within a second, its noise is "
    text += f"{error(noise, 'rad')}, {noise / step:.2g} steps of the converter: "
    text += f"{ratio:.2g} to 1"
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
        yield _good("samples", f"all {r.N} came")
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
    text = f"the sampling interval varies by {microseconds(timing.std_us)}, an angle of "
    text += error(angle, "rad")
    if angle > noise:
        text += ", more than the noise: let the device pace it (--pacing scheduled)"
        yield _warning("timing", text)
    else:
        yield _good("timing", text)


def check_turns(r: Recording) -> Iterator[Finding]:
    """Check where the number of turns was lost."""
    if r.turns_unknown:
        at = ", ".join(f"{r.t[i]:.2f}" for i in r.turns_unknown[:3])
        more = ", …" if len(r.turns_unknown) > 3 else ""
        text = f"the turns are not known from {at}{more} s on, where samples were missing for too "
        yield _warning("turns", f"{text}long (or Ts is): each time a new experiment begins")


def _is_greybox(r: Recording) -> bool:
    return r.manifest.experiment.partition("-")[0] == "greybox"


def converter_step(r: Recording) -> int:
    """Return one step of the converter in counts of 65536."""
    bits = r.manifest.device.get("adc_bits")
    return 1 << (16 - bits) if isinstance(bits, int) and 0 < bits <= 16 else 1
