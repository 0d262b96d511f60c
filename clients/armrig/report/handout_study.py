"""Results for the handout's assignments, as far as the recordings allow, and a section's form."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

from armrig_core.rig.arm import ArmParameters, arm_matrices

from armrig.data.dataset import Dataset
from armrig.estimation.nonparametric.sampling_time import SamplingTime, sampling_time
from armrig.estimation.nonparametric.step_analysis import StepAnalysis, step_analysis
from armrig.physics.grey_box.estimate import greybox
from armrig.physics.grey_box.fit import GreyFit
from armrig.physics.grey_box.split_study import SplitStudy, split_study
from armrig.physics.integrators.accuracy import Recommendation, Sinusoid, recommend_step, sinusoid
from armrig.physics.systems import HANDOUT, chassis
from armrig.recordings.findings import early_end
from armrig.recordings.recording import Recording
from armrig.recordings.usability import NO_MODEL
from armrig.report.study import Orders, Study, best_first, study
from armrig.validation.feedback_and_delay.delay import delay
from armrig.validation.feedback_and_delay.delay_result import Delay
from armrig.validation.feedback_and_delay.open_loop import OpenLoop, open_loop
from armrig.validation.structure_hints import StructureHints, structure_hints

T = TypeVar("T")

OTHERS = (*NO_MODEL, "greybox", "calibrate", "bla")
"""Kinds of experiments from which no black-box model is estimated."""
METHODS = {"4.1": "forward_euler", "4.2": "ab2", "4.3": "trapezoidal", "4.4": "heun"}
"""Integration method of each assignment."""
AMPLITUDE_V, OMEGA, TOLERANCE = 2.5, 10.0, 1e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HandoutStudy:
    """Results of the handout's report; None for a result that the recordings do not allow."""

    recordings: tuple[Recording, ...]
    """Given recordings, complete recordings first."""
    cases: dict[str, ArmParameters]
    """Sets of parameters that assignment 2.3 compares, by name; the first is the handout's set."""
    problem: Sinusoid
    """Arm with a sinusoidal input, for the numerical integration."""
    steps: Recommendation
    """Recommended step of each method."""
    step: StepAnalysis | None = None
    sampling: SamplingTime | None = None
    hints: StructureHints | None = None
    black: Study | None = None
    """Models of the whole rig."""
    alone: Dataset | None = None
    """Data of the chassis without the rotating part."""
    grey: GreyFit | None = None
    split: SplitStudy | None = None
    loop: OpenLoop | None = None
    delay: Delay | None = None
    refused: dict[str, str]
    """Reason why a result is missing, by the name of the result; only for results whose
    recordings exist."""


def handout_study(
    recordings: Sequence[Recording] = (),
    *,
    orders: Orders | None = None,
    cases: dict[str, ArmParameters] | None = None,
    amplitude: float = AMPLITUDE_V,
    omega: float = OMEGA,
) -> HandoutStudy:
    """Compute the results for the assignments; the results of section 3 need recordings.

    Parameters
    ----------
    recordings : sequence of Recording
        Recordings of any kind. The results use the first step, the first two recordings for
        black-box models, and the first recording of the chassis alone. Complete recordings are
        used before recordings that ended early.
    orders : Orders, optional
        Orders of the black-box models.
    cases : dict of str to ArmParameters, optional
        Sets of parameters that assignment 2.3 compares, by name; the first is the handout's set. By
        default there are two more sets: one with J_1 doubled, and one with K_lin doubled.
    amplitude, omega : float
        Amplitude in V and angular frequency in rad/s of the input in assignments 4.1 to 4.4.
    """
    p = ArmParameters()
    A, B, _ = arm_matrices(p)
    refused: dict[str, str] = {}

    def guard(name: str, result: Callable[[], T]) -> T | None:
        try:
            return result()
        except ValueError as err:
            refused[name] = str(err)
            return None

    # Complete recordings come first: a recording that ended early is used only if it is needed.
    # Data of a closed loop come last: the OE models of the handout would be biased.
    recordings = sorted(recordings, key=lambda r: (bool(early_end(r)), r.decisions is not None))
    excited = [r for r in recordings if r.manifest.kind not in OTHERS]
    stepped, alone = _first(recordings, "step"), _first(recordings, "greybox")
    black = guard("black", lambda: best_first(study(excited, orders=orders))) if excited else None
    first = stepped or (excited[0].dataset() if excited else None)
    data = black.estimation if black else excited[0].dataset() if excited else None
    return HandoutStudy(
        recordings=tuple(recordings),
        cases=cases
        or {
            HANDOUT: p,
            "J_1 doubled": replace(p, J_1=2 * p.J_1),
            "K_lin doubled": replace(p, K_lin=2 * p.K_lin),
        },
        problem=sinusoid(A, B, amplitude=amplitude, omega=omega),
        steps=recommend_step(
            A,
            B,
            omega=omega,
            amplitude=amplitude,
            tolerance=TOLERANCE,
            methods=tuple(METHODS.values()),
        ),
        step=guard("step", lambda: step_analysis(stepped)) if stepped else None,
        sampling=guard("sampling", lambda: sampling_time(first)) if first else None,
        hints=guard("hints", lambda: structure_hints(data)) if data else None,
        black=black,
        alone=alone,
        grey=guard("grey", lambda: greybox(alone, model=chassis, free=("J_1",))) if alone else None,
        split=guard("split", lambda: split_study(alone)) if alone else None,
        loop=guard("loop", lambda: open_loop(data)) if data else None,
        delay=guard("delay", lambda: delay(data)) if data else None,
        refused=refused,
    )


def _first(recordings: Sequence[Recording], kind: str) -> Dataset | None:
    return next((r.dataset() for r in recordings if r.manifest.kind == kind), None)
