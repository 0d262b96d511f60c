"""Sections of the report of a study."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from string import ascii_lowercase
from typing import TYPE_CHECKING

from armrig import plots
from armrig.data.dataset import Dataset
from armrig.estimation.nonparametric.spectral import spectral_reference
from armrig.models.characteristics import integrates
from armrig.models.equation import typst_form
from armrig.numerics.quantities import digits, error, join_names, percent
from armrig.recordings.figures import varying_times
from armrig.recordings.usability import emulation, warnings_of
from armrig.report import model_facts, recording_facts
from armrig.report.figures import detail_s, plot_velocity
from armrig.report.recording_facts import run_name, without_turns
from armrig.report.sections import (
    Contents,
    Draw,
    ReportFigure,
    ReportTable,
    Section,
    figure,
    number_sections,
)
from armrig.report.study import OUTPUTS, AssessedFit, Study, each_output
from armrig.validation.comparison import compare

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def study_contents(study: Study, remarks: Sequence[str]) -> Contents:
    """Return the contents of a study's report, with all numbers as text."""
    recording = study.recording_of(study.estimation.source)
    manifest = recording.manifest
    origin = "imported" if recording.is_imported else f"rig {manifest.rig}, recorded"
    truncated = [
        f"{r.path.name} is incomplete: {r.damage}." for r in study.recordings if r.truncated
    ]
    return Contents(
        title=f"{recording.description.title}: black-box identification",
        subtitle=f"{origin} {manifest.started[:16].replace('T', ' ')}",
        front=Section(
            warnings=(*warnings_of(study.recordings), *filter(None, [study.doubt])),
            lead="Summary.",
            paragraphs=(model_facts.abstract(study),),
            points=(*emulation(study.recordings), *remarks, *truncated),
        ),
        sections=number_sections(
            (results(study), data(study), models(study), validation(study), physics(study)),
            appendix=(recordings(study), *([] if recording.is_imported else [sampling(study)])),
        ),
    )


def results(study: Study) -> Section:
    """Return the section with the models' fits and the conclusions."""
    first, *others = _figures(study, "compare")
    velocity = _with_velocity(study)
    table = ReportTable(
        name="fits",
        caption=f"Simulation of the validation data (recording {_run(study.validation, study)}"
        f"). {study.note[0].upper()}{study.note[1:]}.",
        header=(
            *(["output"] if study.others else []),
            *("model", f"fit{' of the angle' * study.of_arm}", "rms error"),
            *(["fit of the velocity"] if velocity else []),
        ),
        rows=tuple(row for part in each_output(study) for row in _fit_rows(part, study)),
    )
    return Section(
        title="Results",
        paragraphs=(
            f"{_references(study, 'compare', '<fits>')} compare the models with the validation "
            "data.",
        ),
        tables=(table,),
        figures=(replace(first, floats=False), *others),
        points=tuple(model_facts.conclusions(study)),
    )


def data(study: Study) -> Section:
    """Return the section on the data, and on their treatment."""
    steps = [r for r in study.recordings if r.manifest.kind == "step"]
    treated = recording_facts.treatment(study)
    sentence = f"{_shows(study, 'data')} the data for the models"
    step: tuple[ReportFigure, ...] = ()
    if steps:
        sentence += ", <step> the step"
        name = OUTPUTS.get(steps[0].first, steps[0].first)
        name = f"{name[0].upper()}{name[1:]}" if study.of_arm else name  # a symbol keeps its case
        motor = "motor's " * study.of_arm
        caption = f"(a) {name} after a step of the {motor}{study.input}; (b) "
        caption += f"the {study.input}; recording {run_name(steps[0])}."
        step = figure("step", caption, 2.0, partial(plots.plot_data, steps[0]))
    return Section(
        title="Data",
        paragraphs=(
            f"{recording_facts.data_text(study)} {sentence}. Samples in a shaded area have no "
            f"{_quantity(study)}. Appendix A describes the recordings.",
            *(["The data were treated in the order of the list."] if treated else []),
        ),
        figures=(*_figures(study, "data"), *step),
        points=tuple(treated),
    )


def models(study: Study) -> Section:
    """Return the section with the equations and the coefficients of the models."""
    each = [f'"{m.name}:" quad {typst_form(m.model)}' for m in study.estimated]
    # More than two equations are wider than the page.
    equations = " quad quad ".join(each) if len(each) < 3 else " \\ ".join(each)
    return Section(
        title="Models",
        paragraphs=(
            f"The orders are {model_facts.orders(study)}. With $q^(-1)$ the delay by one sample "
            "and $e$ white noise:",
            f"$ {equations} $",
            model_facts.structure(study),
        ),
        tables=tuple(
            model_facts.model_table(m, part, study)
            for part in each_output(study)
            for m in part.estimated
        ),
        side_by_side=True,
        points=tuple(model_facts.estimations(study)),
    )


def validation(study: Study) -> Section:
    """Return the section on the simulation and on the tests of the residuals."""
    table = ReportTable(
        name="tests",
        caption="Tests of the one-step residuals on the validation data (recording "
        f"{_run(study.validation, study)}). The tests allow for the uncertainty of the "
        "estimated models.",
        header=(
            "hypothesis",
            *(["output"] if study.others else []),
            *(f"p ({m.name})" for m in study.estimated),
            "a small p points to",
        ),
        rows=model_facts.residual_rows(study),
    )
    return Section(
        title="Validation",
        paragraphs=(
            *model_facts.percent_warning(study),
            f"{_shows(study, 'velocity')} a detail of the simulation. "
            f"{_shows(study, 'residuals')} the correlations that the tests of <tests> use.",
        ),
        tables=(table,),
        figures=(*_figures(study, "velocity"), *_figures(study, "residuals")),
    )


def physics(study: Study) -> Section:
    """Return the section with the responses, which compares them with those of the physics."""
    compared = study.reference is not None
    return Section(
        title="Comparison with the physics" if compared else "Frequency and step responses",
        paragraphs=(
            f"{model_facts.physics(study)}{_shows(study, 'bode')} the frequency responses, "
            f"{_references(study, 'step_poles')} the step responses, poles and zeros.",
        ),
        figures=(*_figures(study, "bode"), *_figures(study, "step_poles")),
    )


def recordings(study: Study) -> Section:
    """Return the section with the facts about the recordings, their files and their notes."""
    table = ReportTable(
        caption="The recordings. Figures name a recording by its run.",
        header=_roles(study),
        rows=recording_facts.facts(study),
        numeric=False,
    )
    return Section(
        title="Recordings",
        tables=(table,),
        points=(
            *(
                f"{recording_facts.role(study, r)}: `{r.path.name}`, SHA-256 `{r.sha256}`"
                for r in study.recordings
            ),
            *recording_facts.setup_sentences(study),
            *recording_facts.notes(study.recordings),
            f"Report by armrig {version('armrig')}.",
        ),
    )


def sampling(study: Study) -> Section:
    """Return the section on the sampling times."""
    table = ReportTable(
        caption="Sampling time and jitter. An interval is the time between two consecutive samples "
        "on the device's clock. Lateness is the time from a sample's deadline to the host's "
        "request for the sample. If the device paced the run, lateness ends with the arrival of "
        "the sample. The rows after the missing samples are from the daemon's reports, one a "
        "second.",
        header=_roles(study),
        rows=recording_facts.timing_rows(study.recordings),
    )
    recording = study.recording_of(study.estimation.source)
    texts = {"jitter": "jitter of the sampling instants", "lateness": "lateness at the host"}
    if not (varying := varying_times(recording)):
        return Section(title="Sampling time", tables=(table,))
    timing = figure(
        "timing",
        f"Histogram of {' and of '.join(map(texts.__getitem__, varying))} in the "
        f"estimation data (recording {run_name(recording)}). Both axes are logarithmic. Values "
        "below the clock's resolution are at the left edge.",
        2.2,
        *(partial(plots.plot_timing, recording, quantity=quantity) for quantity in varying),
    )
    paragraphs = ("<timing> shows the distributions.",)
    return Section(title="Sampling time", paragraphs=paragraphs, tables=(table,), figures=timing)


def _roles(study: Study) -> tuple[str, ...]:
    return ("", *(recording_facts.role(study, r) for r in study.recordings))


def _run(data: Dataset, study: Study) -> str:
    return run_name(study.recording_of(data.source))


def _with_velocity(study: Study) -> bool:
    return any(part.models[0].velocity_fit_percent is not None for part in each_output(study))


def _quantity(study: Study) -> str:
    """Return the word for a value of the outputs."""
    return "angle" if study.of_arm else "value"


def _fit_rows(part: Study, study: Study) -> Iterator[tuple[str, ...]]:
    """Yield a row for each model: its fits and its rms error for one output."""
    for k, row in enumerate(part.models):
        velocity = "–" if row.velocity_fit_percent is None else percent(row.velocity_fit_percent)
        yield (
            *([part.symbol if k == 0 else ""] if study.others else []),
            row.name,
            percent(row.fit_percent),
            error(row.rms_error, part.validation.unit),
            *([velocity] if _with_velocity(study) else []),
        )


def _references(study: Study, name: str, *before: str) -> str:
    return join_names(
        [*before, *(f"<{name}{_suffix(part, study)}>" for part in each_output(study))]
    )


def _shows(study: Study, name: str) -> str:
    return f"{_references(study, name)} {'show' if study.others else 'shows'}"


def _figures(study: Study, name: str) -> tuple[ReportFigure, ...]:
    """Return the figure `name` of each output."""
    return tuple(
        ReportFigure(f"{name}{_suffix(part, study)}", *_drawings(part)[name])
        for part in each_output(study)
    )


def _suffix(part: Study, study: Study) -> str:
    """Return the suffix in the names of an output's figures; "" for the first output."""
    return "" if part is study else f"-{part.output}"


def _drawings(part: Study) -> dict[str, tuple[str, float, tuple[Draw, ...]]]:
    """Return the caption, the height and the panels of each figure of one output."""
    estimation, validation = (_run(data, part) for data in (part.estimation, part.validation))
    marks = ascii_lowercase[: 2 * len(part.estimated)]
    halves = ", the first and the second half of one recording" if part.halves else ""
    angle, ramp = part.angle, without_turns(part.validation)
    the = f"the {angle}" if part.of_arm else angle
    turns = " with its turns counted" if part.integrates else ""
    detail = f"rate of {the}, from differences" if part.integrates else angle
    drawn = [f"{angle}{turns}{without_turns(data)}" for data in (part.estimation, part.validation)]
    angles = f"(a, c) {drawn[0]}" if drawn[0] == drawn[1] else f"(a) {drawn[0]}; (c) {drawn[1]}"
    rate = "Rate" if all(integrates(m.model) for m in part.models) else "Response"
    fits, names = [m.model for m in part.models], [m.name for m in part.models]
    count = len(part.estimated)
    unit = part.estimation.input_unit or "unit"
    played = "" if part.recordings[0].is_imported else " that the device applied"
    return {
        "data": (
            f"Estimation data (a, b; recording {estimation}) and validation data (c, d; "
            f"recording {validation}){halves}: {angles}; (b, d) {part.input}{played}. "
            f"Shaded: {'dead band or ' * part.of_arm}missing sample.",
            2.4,
            tuple(partial(plots.plot_data, data) for data in (part.estimation, part.validation)),
        ),
        "compare": (
            f"(a) Measured and simulated {angle} of the validation data (recording "
            f"{validation}){ramp}; (b) data (dots) and models, minus the best model. If a model "
            "has a much larger error, the scale is logarithmic beyond the dotted lines.",
            3.0,
            (compare(part.validation, *fits[:count], labels=names[:count]).plot,),
        ),
        "velocity": (
            f"Detail of {digits(detail_s(part.validation), 3)} s: {detail} (recording "
            f"{validation}). The simulation of the models starts at the beginning of the data.",
            2.0,
            (partial(plot_velocity, part),),
        ),
        "bode": (
            f"Frequency response from {part.input} to {angle}, (a) magnitude and (b) phase, with "
            "95 % bands. A band is linearised or, if a linearisation is poor, sampled from the "
            "covariance of the parameters. Dots: spectral analysis of the estimation data with "
            f"95 % bars. Recording {estimation}.",
            3.4,
            (partial(_plot_bode, part),),
        ),
        "step_poles": (
            f"(a) {rate} of {the} after a step of 1 {unit}, with 95 % bands; (b) poles (×) and "
            "zeros (○) with 95 % regions: bars for real roots, ellipses for complex roots, dotted "
            "if sampled. A square marks a pole and a zero that are not significantly different "
            f"(1 %). Models from recording {estimation}.",
            2.7,
            tuple(
                partial(plot, *fits, labels=names)
                for plot in (plots.plot_step, plots.plot_poles_zeros)
            ),
        ),
        "residuals": (
            f"Correlation of the residuals of {the} with themselves ({', '.join(marks[::2])}) and "
            f"with the input ({', '.join(marks[1::2])}) on recording {validation}. Grey: range of "
            "99 % of the values if the hypothesis is true.",
            4.4 if count == 3 else 3.4 * -(-count // 2),
            tuple(partial(_plot_residuals, m) for m in part.estimated),
        ),
    }


def _plot_bode(part: Study, *, ax: Axes) -> None:
    names = [*(m.name for m in part.models), "spectral analysis, 95 %"]
    models = *(m.model for m in part.models), spectral_reference(part.estimation)
    plots.plot_bode(*models, labels=names, ax=ax)


def _plot_residuals(model: AssessedFit, *, ax: Axes) -> None:
    model.tests.plot(ax=ax)
    ax.set_ylabel(f"{model.name}: {ax.get_ylabel()}")
