"""Run in control of a recording: its law, and the decisions of the law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from armrig_core.control.control_law import ControlLaw
from armrig_core.process.printable import printable
from armrig_core.recording_file.manifest import CONTROLLER
from numpy.typing import NDArray

from armrig.data.columns import Vector
from armrig.numerics.quantities import plural
from armrig.numerics.stretches import Mask
from armrig.recordings.decisions import DecisionCounts
from armrig.recordings.files.loading import beginning
from armrig.recordings.recording import Recording

_MAX_METHOD = 40  # characters


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ControlRun:
    """Law of a run, and its decisions; element i of an array (N,) belongs to decision i."""

    law: ControlLaw
    k: NDArray[np.int64]
    """Number of the sample together with which the input was latched."""
    r: Vector
    """Reference, in the unit of the law."""
    v: Vector
    """Voltage before the limits, in V."""
    u: Vector
    """Commanded voltage, in V."""
    is_low: Mask
    """True if v was below the lowest voltage."""
    is_high: Mask
    """True if v was above the highest voltage."""
    is_slewed: Mask
    """True if the change of the voltage was limited."""
    predicted: NDArray[np.int64]
    """Number of samples that had not arrived, and that the law predicted."""
    reference_n: NDArray[np.int64]
    """Number of the command that set r; 0 for the reference with which the run began."""

    @property
    def counts(self) -> DecisionCounts:
        """Return the numbers of decisions."""
        marks = (self.is_low | self.is_high, self.is_slewed, self.predicted)
        return DecisionCounts(self.k.size, *(int(np.count_nonzero(mark)) for mark in marks))

    def facts(self) -> dict[str, Any]:
        """Return hash, monitor, reference and shares of the run, by name, for programs."""
        counts, count = self.counts, max(self.k.size, 1)
        return {
            "law_sha256": self.law.sha256,
            "monitored": self.law.monitor is not None,
            "method": printable(str(self.law.design.get("method", ""))[:_MAX_METHOD]),
            "reference": [float(self.r.min()), float(self.r.max())] if self.k.size else [],
            "references_set": np.unique(self.reference_n[self.reference_n > 0]).size,
            "decisions": counts.decisions,
            "limited_share": counts.limited / count,
            "slewed_share": counts.slewed / count,
            "predicted": counts.late,
        }

    @property
    def shares(self) -> str:
        """Return the shares of decisions at a limit, and with predicted samples, as text."""
        return self.counts.limits_text

    @property
    def summary(self) -> str:
        """Return law, reference and shares of the run as text."""
        facts, r = self.facts(), self.law.reference
        method = f"{facts['method']} " if facts["method"] else ""
        text = f"law {method}{self.law.sha256[:12]}"
        if self.k.size:
            low, high = facts["reference"]
            text += f", {r.name} {low:.4g} to {high:.4g} {r.unit}"
        if changed := facts["references_set"]:
            text += f", set by {plural(changed, 'command')}"
        return f"{text}{'' if facts['monitored'] else ', without a monitor'}; {self.shares}"


class OwnControlRun(NamedTuple):
    """Voltages that the client of a run set; element i of an array (N,) belongs to sample k[i]."""

    k: NDArray[np.int64]
    r: Vector
    u: Vector
    """Commanded voltage, in V."""
    missed: NDArray[np.int64]
    """Number of missed deadlines, up to this sample."""

    def facts(self) -> dict[str, Any]:
        """Return the numbers of deadlines and of missed deadlines, by name, for programs."""
        return {"deadlines": max(0, self.k.size - 1), "missed": int(self.missed.max(initial=0))}

    @property
    def summary(self) -> str:
        """Return the share of missed deadlines as text."""
        return "own controller: {missed} of {deadlines} deadlines missed".format(**self.facts())


def law_of(attachments: Mapping[str, bytes]) -> ControlLaw | None:
    """Return the attached law; None without one. Raises InputError if it is no law."""
    text = attachments.get(CONTROLLER)
    return None if text is None else ControlLaw.of(text)


def control_run(recording: Recording) -> ControlRun | None:
    """Return the law and the decisions of a recording; None for a run without a law.

    Raises FileError or InputError if the file cannot be read, or its law is none.
    """
    if not recording.manifest.controller_sha256 or recording.decisions is None:
        return None
    law = law_of(beginning(recording.path)[1].attachments)
    if law is None:
        return None
    decisions = recording.decisions()
    return ControlRun(
        law=law,
        k=decisions["k"].astype(np.int64),
        r=decisions["r"],
        v=decisions["v"],
        u=decisions["u_v"],
        is_low=decisions["is_low"].astype(np.bool_),
        is_high=decisions["is_high"].astype(np.bool_),
        is_slewed=decisions["is_slewed"].astype(np.bool_),
        predicted=decisions["predicted"].astype(np.int64),
        reference_n=decisions["reference_n"].astype(np.int64),
    )


def own_control_run(recording: Recording) -> OwnControlRun | None:
    """Return the voltages that the client of a run in control set; None for another run."""
    if recording.manifest.controller_sha256 != "" or recording.decisions is None:
        return None
    decisions = recording.decisions()
    k, missed = (decisions[name].astype(np.int64) for name in ("k", "predicted"))
    return OwnControlRun(k, decisions["r"], decisions["u_v"], missed)
