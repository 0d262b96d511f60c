"""What speaks against using recordings as they are meant to be: told before any number."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from armrig_core.codes import OutcomeCode

from armrig.numerics.quantities import listed

if TYPE_CHECKING:
    from armrig.recordings.recording import Recording

FEW = 300
"""Samples below which the deviations of a model of the rig say little."""
_TO_THE_END = (OutcomeCode.COMPLETE, OutcomeCode.CONTINUED)
_TURNED = 0.5  # rad by which a chassis must have turned before its direction is judged
NO_MODEL = ("step", "staircase")
"""Kinds of experiment that hardly excite: shown, and not identified from."""


def doubts(recording: Recording) -> list[str]:
    """Return what speaks against a recording, one sentence each; none is best."""
    name = recording.path.name
    found = []
    if 0 < recording.samples.size < FEW:
        found.append(
            f"{name} has {recording.samples.size} samples: models of so few are poor; record "
            f"{FEW} or more"
        )
    if _reversed(recording):
        found.append(
            f"{name}: theta_1 falls although the voltage is positive, so its potentiometer is "
            "reversed, or the motor's wires are; run `armrig calibrate`"
        )
    return found


def emulation(recordings: Sequence[Recording]) -> list[str]:
    """Return which recordings are of an emulated rig; nothing if none is."""
    names = [r.path.name for r in recordings if r.manifest.emulated]
    if not names:
        return []
    if len(names) == len(recordings):
        return ["The rig was emulated: these are no measurements of a real rig."]
    return [f"The rig was emulated in {listed(names)}: these are no measurements of a real rig."]


def ended_early(recording: Recording) -> bool:
    """Return whether a run ended before the end of its input, or nothing says how it ended."""
    return recording.outcome is None or recording.outcome.code not in _TO_THE_END


def early_ends(recordings: Sequence[Recording]) -> list[str]:
    """Return which recordings ended early, and why, a sentence each.

    A recording of no certain length (`armrig record`) has no end that is too early.
    """
    return [
        f"{r.path.name} ended early, after {r.samples.size} of {r.manifest.samples} samples: "
        f"{r.outcome.outcome if r.outcome else 'nothing says why'}."
        for r in recordings
        if ended_early(r) and r.manifest.samples
    ]


def different_calibrations(recordings: Sequence[Recording]) -> list[str]:
    """Return which recordings were made with which calibration; nothing if all have the same."""
    of: dict[tuple[object, ...] | None, list[str]] = {}
    for r in recordings:
        of.setdefault(_values(r), []).append(r.path.name)
    if len(of) < 2:
        return []
    groups = "; ".join(listed(names) for names in of.values())
    return [
        f"The recordings were made with {len(of)} different calibrations ({groups}): their angles "
        "and voltages do not compare. Read all with one, `--calibration FILE`."
    ]


def doubts_of_estimation(recording: Recording) -> list[str]:
    """Return what speaks against estimating a model of any order from a recording."""
    kind = recording.manifest.experiment.partition("-")[0]
    if kind not in NO_MODEL:
        return []
    return [
        f"{recording.path.name} is a {kind}, which excites few frequencies: a model from it says "
        "little; identify from a telegraph (`armrig collect blackbox`)"
    ]


def doubts_of_pair(first: Recording, other: Recording, *, one_plant: bool = True) -> list[str]:
    """Return what speaks against judging models of `first` by `other`, one sentence each.

    Without `one_plant` the chassis alone may stand beside the whole rig.
    """
    a, b = first.manifest, other.manifest
    name = other.path.name
    found = []
    kind = b.experiment.partition("-")[0]
    if kind in NO_MODEL:
        found.append(
            f"{name} is a {kind}, which excites few frequencies: a fit on it says little; validate "
            "on another telegraph (`armrig collect blackbox --validation`)"
        )
    if a.rig != b.rig or a.device.get("uid") != b.device.get("uid"):
        found.append(
            f"{first.path.name} is of {_rig(first)}, {name} of {_rig(other)}: a model of one rig "
            "is none of another"
        )
    elif _values(first) != _values(other):
        found.append(
            f"{first.path.name} and {name} were made with different calibrations: read both with "
            "one (--calibration TOML)"
        )
    if one_plant and _experiment(first) != _experiment(other):
        found.append(
            f"{first.path.name} is of {_experiment(first)}, {name} of {_experiment(other)}: the "
            "chassis alone and the whole rig are two plants"
        )
    return found


def all_doubts(recordings: Sequence[Recording], *, one_plant: bool = True) -> list[str]:
    """Return what speaks against each, and against each with the first that excites."""
    found = [text for r in recordings for text in doubts(r)]
    excited = [r for r in recordings if r.manifest.experiment.partition("-")[0] not in NO_MODEL]
    for n, other in enumerate(excited[1:]):
        # Only the second judges what the first gives: the chassis may be told of beside them.
        found += doubts_of_pair(excited[0], other, one_plant=one_plant and n == 0)
    return found


def _reversed(r: Recording) -> bool:
    """Tell whether the angle falls: the voltage is never negative, so the chassis turns one way."""
    angle = r.theta_1[np.isfinite(r.theta_1)]
    return angle.size > 1 and float(angle[-1] - angle[0]) < -_TURNED


def _rig(r: Recording) -> str:
    uid = r.manifest.device.get("uid")
    return f"rig {r.manifest.rig}" + (f" (device {uid})" if uid else "")


def _experiment(r: Recording) -> str:
    return "the chassis alone" if r.manifest.experiment.startswith("greybox") else "the whole rig"


def _values(r: Recording) -> tuple[object, ...] | None:
    c = r.calibration
    return None if c is None else (c.theta_1, c.alpha, c.driver)
