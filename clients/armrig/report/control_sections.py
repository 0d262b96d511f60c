"""Report of a run in control: prediction and measurement, model, design, robustness, recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from typing import Any

import numpy as np
from armrig_core.commands.commands import rehearsal_sentence

from armrig import plots
from armrig.control.law_check import LawCheck, check_law
from armrig.control.loop_comparison import LoopComparison, StepFigures, compare_loop
from armrig.control.requirement import requirement_of
from armrig.data.columns import Vector
from armrig.models.equation import typst_form
from armrig.models.fit import Fit
from armrig.numerics.quantities import digits, plural
from armrig.recordings.files.control_run import control_run
from armrig.recordings.recording import Recording
from armrig.recordings.usability import emulation, warnings_of
from armrig.report.recording_facts import notes, run_facts, run_name
from armrig.report.sections import Contents, ReportTable, Section, figure, number_sections, plain


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlStudy:
    """A run in control with its model, its prediction and the margins of its law."""

    recordings: tuple[Recording, ...]
    """The run alone."""
    model: Fit
    comparison: LoopComparison
    check: LawCheck

    @property
    def run(self) -> Recording:
        """Recording of the run."""
        return self.recordings[0]


def control_study(recording: Recording, model: Fit) -> ControlStudy:
    """Return a recorded run in control with its prediction and its margins on a model.

    Raises
    ------
    InputError
        The recording has no law, or the model has other outputs or another sampling time.
    """
    comparison = compare_loop(recording, model)
    check = check_law(comparison.law, model, rig=recording.description)
    return ControlStudy(recordings=(recording,), model=model, comparison=comparison, check=check)


def control_contents(study: ControlStudy) -> Contents:
    """Return the contents of the report of a run in control, with all numbers as text."""
    run, manifest = study.run, study.run.manifest
    doubts, comparison = study.comparison.doubts, study.comparison
    summary = replace(comparison, doubts=()).verdict.split("\n")
    return Contents(
        title=f"{run.description.title}: closed loop",
        subtitle=f"rig {manifest.rig}, recorded {manifest.started[:16].replace('T', ' ')}",
        front=Section(
            warnings=(
                *warnings_of(study.recordings),
                *([f"In doubt: {'; '.join(doubts)}."] if doubts else []),
                *([] if comparison.law.monitor else ["The law has no monitor."]),
            ),
            lead="Summary.",
            paragraphs=(plain(" ".join(summary)),),
            points=tuple(emulation(study.recordings)),
        ),
        sections=number_sections(
            (section(study) for section in (_requirement, _result, _model, _design, _robustness)),
            appendix=(_recording(study),),
        ),
    )


def _requirement(study: ControlStudy) -> Section:
    """Return the section with the requirement of the law's file, and the aim of its design."""
    law = study.comparison.law
    requirement, aims = requirement_of(law.design), _aims(law.design)
    aim = [plain(f"The design asked for {aims}.")] if aims else []
    if requirement is None:
        return Section(
            title="Requirement",
            paragraphs=("The file of the law has no requirement on a step.", *aim),
        )
    measured = study.comparison.worst_step
    table = ReportTable(
        caption="Requirement on a step of the reference. The prediction is the upper end of the "
        "95 % band over draws of the model, without limits of the voltage; the measurement is the "
        "worst step of the run.",
        header=("", "at most", "predicted", "measured"),
        rows=tuple(requirement.rows(study.check.latest, measured)),
    )
    sentence = requirement.sentence(measured, "The run")
    return Section(title="Requirement", paragraphs=(plain(sentence), *aim), tables=(table,))


def _aims(design: Mapping[str, Any]) -> str:
    """Return what the method of a design had to reach, as text; "" if the file has none."""
    texts = {
        "poles": f"poles of the loop at {_poles(design.get('poles'))}",
        "time_constant": f"a time constant of {_text(design.get('time_constant'))} s",
        "ms": f"the largest integral gain with Ms at most {_text(design.get('ms'))}",
        "effort": f"the least weighted squares of error and voltage, with an effort of "
        f"{_text(design.get('effort'))}",
    }
    return ", ".join(text for name, text in texts.items() if name in design)


def _result(study: ControlStudy) -> Section:
    loop, r = study.comparison, study.comparison.law.reference
    rows = [
        (f"{step.before:.4g} to {step.after:.4g} {r.unit}", f"{step.at:.4g} s", *_pair(step, model))
        for step, model in loop.steps()
    ]
    table = ReportTable(
        caption="Steps of the reference after the prelude. The measured overshoot is that of the "
        "prediction with its mean deviation over 15 samples, because the peak of a noisy signal is "
        "too high.",
        header=("step", "at", "overshoot", "predicted", "5 % settling", "predicted"),
        rows=tuple(rows),
    )
    caption = (
        f"(a) {plain(r.name)} and its reference; (b) the voltage and its limits; recording "
        f"{run_name(study.run)}. The prediction uses the recorded law, reference and model alone."
    )
    return Section(
        title="Prediction and measurement",
        paragraphs=(
            "<loop> shows the run. The prediction evaluates the law on the model from rest, "
            "without noise. "
            + (
                f"In the shaded prelude of {digits(loop.prelude * loop.Ts, 3)} s the loop is "
                "open: the voltage is the feed-forward of the reference."
                if loop.prelude
                else "The law has no prelude."
            ),
        ),
        tables=(table,) if rows else (),
        figures=figure(
            "loop", caption, 3.6, partial(plots.plot_loop_comparison, loop), floats=False
        ),
        points=_saturation(study),
    )


def _pair(measured: StepFigures, model: StepFigures) -> tuple[str, ...]:
    pairs = ((f"{step.overshoot:.0f} %", _settling(step)) for step in (measured, model))
    (over, settled), (over_model, settled_model) = pairs
    return over, over_model, settled, settled_model


def _settling(step: StepFigures) -> str:
    return f"{digits(step.settling, 3)} s" if np.isfinite(step.settling) else "not reached"


def _saturation(study: ControlStudy) -> tuple[str, ...]:
    run, law = control_run(study.run), study.comparison.law
    rehearsal = study.run.manifest.rehearsal
    measured, predicted = map(_range, (study.comparison.u, study.comparison.predicted_u[0]))
    sentences = [
        f"The law may command {law.lo:g} to {law.hi:g} V. It commanded {measured} (predicted "
        f"{predicted})."
    ]
    if run is not None:
        sentences.append(f"{run.shares[0].upper()}{run.shares[1:]}.")
    if rehearsal is not None:
        text = rehearsal_sentence(rehearsal)
        sentences.append(f"{text[0].upper()}{text[1:]}.")
    return tuple(sentences)


def _range(u: Vector) -> str:
    return f"{digits(u.min(), 3)} to {digits(u.max(), 3)} V"


def _model(study: ControlStudy) -> Section:
    model = study.model
    channels = [model[output, model.inputs[0]] for output in model.outputs]
    equations = " \\ ".join(dict.fromkeys(typst_form(channel) for channel in channels))
    names = plain(", ".join(model.outputs))
    return Section(
        title="Model",
        paragraphs=(
            f"The prediction is that of a model of {names}, with $q^(-1)$ the delay by one sample "
            "and $e$ white noise:",
            f"$ {equations} $",
        ),
    )


def _design(study: ControlStudy) -> Section:
    law = study.comparison.law
    monitor = law.monitor
    facts: list[tuple[str, str]] = [
        ("method", plain(str(law.design.get("method", "not named")))),
        ("states", str(law.order)),
        ("sampling time", f"{law.Ts_us / 1e6:g} s"),
        ("reference", f"{plain(law.reference.name)} [{plain(law.reference.unit)}]"),
        ("outputs", plain(", ".join(o.name for o in law.outputs))),
        ("dead time in the law", plural(law.input_delay, "sample")),
        ("monitor", f"{plural(len(monitor.x0), 'state')}" if monitor else "none"),
    ]
    settings = {k: v for k, v in law.design.items() if k not in _ELSEWHERE}
    settings |= {k: _poles(v) for k, v in settings.items() if k == "poles"}
    facts += [(plain(k), plain(_text(v))) for k, v in settings.items() if _text(v)]
    gains = {k: v for k, v in law.design.get("gains", {}).items() if isinstance(v, int | float)}
    facts += [(f"gain {plain(k)}", _text(v)) for k, v in gains.items()]
    table = ReportTable(
        caption="The law. Its file is attached to the recording as controller.json.",
        header=("", "value"),
        rows=tuple((name, value) for name, value in facts),
        numeric=False,
    )
    return Section(
        title="Design",
        paragraphs=("<diagram> shows the loop.",),
        figures=figure(
            "diagram",
            "The loop. The voltage of sample k depends on the outputs up to k - 1. The law uses "
            "the limited voltage, so that it does not wind up.",
            1.7,
            partial(plots.plot_loop_diagram, law),
        ),
        tables=(table,),
    )


_ELSEWHERE = frozenset(
    {"method", "model_sha256", "doubts", "files", "margins", "gains", "requirement"}
)
"""Facts of a design that other parts of the report show."""
_MAX_LENGTH = 80  # characters of a setting


def _poles(pairs: Any) -> str:
    """Return poles of a law's file as text, a conjugate pair once; "" if they are no poles."""
    try:
        poles = [(float(real), float(imag)) for real, imag in pairs]
    except (TypeError, ValueError):
        return ""
    texts = [
        f"{real:.4g} ± {imag:.4g}i" if imag else f"{real:.4g}" for real, imag in poles if imag >= 0
    ]
    return f"{', '.join(texts)} rad/s"[:_MAX_LENGTH]


def _text(value: Any) -> str:
    """Return a setting of a design as text; "" for other values than numbers, texts and lists."""
    if isinstance(value, list):
        return ", ".join(filter(None, map(_text, value)))[:_MAX_LENGTH]
    if isinstance(value, float):
        return f"{value:.5g}"
    return str(value)[:_MAX_LENGTH] if isinstance(value, int | str) else ""


def _robustness(study: ControlStudy) -> Section:
    check = study.check
    rows = {"model": check.nominal} | dict(check.corners)
    table = ReportTable(
        caption="Margins on the model and on corners: Ms is the largest sensitivity.",
        header=("", "Ms", "gain margin", "phase margin", "delay margin"),
        rows=tuple(
            (
                name,
                digits(m.Ms, 3),
                digits(m.gain, 3),
                f"{m.phase_deg:.1f}°",
                f"{digits(m.delay_s, 3)} s" if np.isfinite(m.delay_s) else "infinite",
            )
            for name, m in rows.items()
        ),
    )
    return Section(
        title="Robustness",
        paragraphs=(plain(check.verdict.replace("\n", " ")), "<margins> shows the open loop."),
        tables=(table,),
        figures=figure(
            "margins",
            "Open loop with draws of the model: (a) Nyquist diagram with the circle of Ms; (b) and "
            "(c) Bode diagram.",
            3.2,
            partial(plots.plot_nyquist, check),
            partial(plots.plot_loop, check),
        ),
    )


def _recording(study: ControlStudy) -> Section:
    run = study.run
    hashes = {
        "the recording": run.sha256,
        "the law with its requirement": study.comparison.law.sha256,
        "the reference": run.manifest.input_sha256,
        "the model's parameters": study.comparison.model_sha256,
        "the model's data": study.model.source,
        "the rig's description": run.manifest.description_sha256,
    }
    table = ReportTable(
        caption="The recording.",
        header=("", "run"),
        rows=tuple((name, value) for name, value in run_facts(run).items() if value),
        numeric=False,
    )
    return Section(
        title="Recording",
        tables=(table,),
        points=(
            f"Recording `{run.path.name}`.",
            *(f"SHA-256 of {name}: `{sha256}`." for name, sha256 in hashes.items() if sha256),
            *notes(study.recordings),
            f"Report by armrig {version('armrig')}.",
        ),
    )
