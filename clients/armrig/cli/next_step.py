"""Next commands in the order of the handout, ready to copy."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterable, Mapping, Sequence, Set
from contextlib import suppress
from dataclasses import replace
from itertools import chain, count
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any, Literal

from armrig_core.errors import ArmrigError
from armrig_core.process.printable import printable
from armrig_core.recording_file.budget import DamageError
from armrig_core.telemetry.channels import INTEGRATING_OUTPUTS
from msgspec import structs

from armrig.cli.recorded_data import SignalChoice, from_arm, from_recording, has_level
from armrig.data.files import RECORDING
from armrig.estimation.request import Request, options_of
from armrig.models.structure_table import OFFERED, STRUCTURES

if TYPE_CHECKING:
    from armrig.cli.identify import IdentifyOutcome
    from armrig.data.dataset import Dataset, Signals
    from armrig.data.finding import Finding
    from armrig.models.fit import Fit
    from armrig.recordings.files.origin import Origin
    from armrig.recordings.files.recording_summary import RecordingSummary
    from armrig.recordings.recording import Recording
    from armrig.validation.residual_test import ResidualTest

_MAX_NAME_LENGTH = 28  # letters of a name before the suffix; further letters are cut off
_AGAIN = "-again"  # suffix of the name of a repeated step

NEXT: Mapping[str, str] = {
    "collect step": "armrig collect step{rig} --Ts 0.002 --seconds 10 --name first",
    "collect step other": "armrig collect step{rig} --name first",
    "collect step again": "armrig collect step{rig}{again}",
    "collect greybox": "armrig collect greybox{rig} --Ts 0.01 --seconds 30 --seed 3 --name chassis",
    "collect pair": "armrig collect blackbox{rig} --Ts {Ts:g} --seconds {seconds:g}{switching} "
    "--validation",
    "collect blackbox": "armrig collect blackbox{rig} --Ts {Ts:g} --seconds 30 --seed 2",
    "conformance": "armrig conformance --device {port}",
    "model": "armrig model --set J_2=0.005 --set K_lin=2.4 -o step.png",
    "lab": "armrig lab",
    "lab chassis": "armrig lab --config chassis.toml",
    "open": "{opener} {file}",
    "status": "armrig status{rig}",
    "import": "armrig import {file}{given} --mask-rails",
    "info": "armrig info {file}",
    "plot": "armrig plot {file}",
    "sampling": "armrig sampling {file} -o sampling.png",
    "hints": "armrig hints {file}{given} -o hints.png",
    "identify": "armrig identify {file} {options}{validate} --save {model}",
    "control": "armrig identify {file} --structure bj --search{given} --save loop.json",
    "compare laws": "armrig compare {file} --model {model} --model {design} -o compare.png",
    "validate": "armrig validate {validation} --model {model}{given} -o validate.png",
    "compare": "armrig compare {estimation} {file} --model {model} -o compare.png",
    "simulate": "armrig simulate {file} --model {model}{part} -o simulate.png",
    "check": "armrig check {file}{given}",
    "greybox": "armrig greybox {file} -o chassis.png",
    "split": "armrig split {file}{given} -o split.png",
    "integrate": "armrig integrate -o integrate.png",
    "report": "armrig report {file} -o report.pdf",
    "handout": "armrig report --handout{files}{answers}{sinusoid} -o {report}",
    "questions": "armrig report --handout{files} --questions {questions}",
}
"""Commands that the line `next:` names; names in braces are replaced by values."""
OF_KIND: Mapping[str, str] = {"step": "sampling", "greybox": "greybox", "control": "control"}
"""Name of the command after a recording of a kind, if the kind has such a command."""
REASONS = Path("reasons.toml")
"""Usual file with the answers to the handout's questions."""


def say_next(name: str, origin: Origin | None = None, /, **values: str | float) -> None:
    """Print the line `next: …` with a command of `NEXT`, on standard error."""
    say_to_copy(next_line(name, origin, **values))


def say_to_copy(text: str) -> None:
    """Print lines to copy on standard error, without folding."""
    with suppress(OSError):  # the terminal may be closed
        print(printable(text, keep="\n"), file=sys.stderr)


def next_line(name: str, origin: Origin | None = None, /, **values: str | float) -> str:
    """Return the line `next: …` with a command of `NEXT`.

    `origin` is that of the recording or rig that the command before was about. The line names only
    recordings and rigs of this origin.
    """
    opener = {"darwin": "open", "win32": "start"}.get(sys.platform, "xdg-open")
    defaults = {
        "opener": opener,
        "given": "",
        "validate": "",
        "rig": option_for_rig(origin.rig if origin else "1"),
    }
    line = NEXT[name].format(**defaults | values)
    return f"next: {printable(_goes_on(line, origin))}"


def _goes_on(line: str, origin: Origin | None) -> str:
    """Return the command, or a later command if the rig runs or the recording already exists."""
    from armrig_core.rig.description import builtin

    from armrig.recordings.files.origin import Origin

    words = shlex.split(line)
    if words[1:] == ["lab"]:
        with suppress(ImportError, ArmrigError):  # not on Windows
            from armrig.rig.session import local_rigs

            if "1" in local_rigs():
                words = shlex.split(line := NEXT["collect step"].format(rig=""))
    if words[1] != "collect":
        return line
    rig = words[words.index("--rig") + 1] if "--rig" in words else "1"
    # Without a recording or a rig before, the next steps are the handout's: those of the arm.
    origin = origin or Origin(rig=rig, description_sha256=builtin("arm").sha256)
    recordings = own_recordings()
    alike = [s for s in recordings if origin.matches(s)]
    estimated = [first for first, _ in _pairs(alike, "blackbox")]
    if "--validation" in words:
        Ts = float(words[words.index("--Ts") + 1])
        pair = next((s for s in estimated if s.Ts == Ts), None)
        return NEXT["plot"].format(file=command_line_name(pair.path)) if pair else line
    if words[-2] != "--name":
        return line
    names = f"{words[-1]}{_AGAIN}", words[-1]  # prefer the repeated run
    named = [s for name in names for s in recordings if name in s.names(validation=False)]
    usable = [s for s in named if s in alike]
    if not usable:  # a recording of another origin keeps its name
        return line.rpartition("--name")[0].rstrip() if named else line
    if usable[0].kind == "step" and estimated:
        return NEXT["hints"].format(file=command_line_name(estimated[0].path), given="")
    return NEXT[OF_KIND.get(usable[0].kind, "plot")].format(file=command_line_name(usable[0].path))


def own_recordings() -> list[RecordingSummary]:
    """Return the complete recordings in the recording folder, newest first; none on an error."""
    from armrig.recordings.files import recording_names as names
    from armrig.recordings.files.catalogue import catalogue

    with suppress(names.NoSuchRecordingError, OSError):
        return [s for s in catalogue(names.recording_folder()).recordings if s.is_complete]
    return []


def free_recording_name(name: str) -> str:
    """Return the first of NAME, NAME-2, NAME-3 … that no complete recording has."""
    used = {x for s in own_recordings() for x in s.names(validation=False)}
    names = chain([name], (f"{name}-{n}" for n in count(2)))
    return next(name for name in names if name not in used)


def _pairs(
    recordings: Sequence[RecordingSummary], *kinds: str
) -> list[tuple[RecordingSummary, ...]]:
    """Return estimation and validation recordings of one Ts and origin, newest first."""
    from armrig.recordings.files.origin import Origin

    estimations: dict[str, list[RecordingSummary]] = {}
    for s in recordings:
        if not s.is_validation:
            estimations.setdefault(s.run_id, []).append(s)
    return [
        (a, b)
        for b in recordings
        if b.is_validation and b.kind in (kinds or (b.kind,))
        for a in estimations.get(b.validation_of, ())
        if a.kind == b.kind and a.Ts == b.Ts and Origin.of_summary(a).matches(b)
    ]


def counterpart(path: Path, wanted: Literal["estimation", "validation"]) -> str:
    """Return the name of the wanted recording of the pair with `path`; "" if none exists."""
    pairs = [(a, b) if wanted == "validation" else (b, a) for a, b in _pairs(own_recordings())]
    partners = (other for summary, other in pairs if summary.path.absolute() == path.absolute())
    return next((command_line_name(other.path) for other in partners), "")


def step_again(recording: Recording) -> str:
    """Return the options that repeat a step if the dead band hid its rise; otherwise "".

    A chassis that rests before the step must be turned by hand; the result is then "", too.
    """
    from armrig.recordings.findings import check_step, step_options

    manifest, hidden = recording.manifest, check_step(recording)
    options = step_options(hidden.numbers) if hidden else ""
    name = manifest.experiment.partition("-")[2]
    named = f" --name {quote(f'{name[:_MAX_NAME_LENGTH]}{_AGAIN}')}" if name else ""
    return f" --Ts {manifest.every * manifest.Ts:g} {options}{named}" if options else ""


def option_for_rig(rig: str, connect: str | None = None) -> str:
    """Return the options that name a rig and its endpoint; "" for the defaults."""
    named = "" if rig == "1" else f" --rig {rig}"
    return f"{named} --connect {quote(connect)}" if connect else named


def command_line_name(path: Path) -> str:
    """Return the @name of a recording, or its quoted path, as a user types it."""
    from armrig.recordings.files.recording_names import name_of

    return name_of(path) or quote(str(path))


def free_name() -> str:
    """Return the first name of report.pdf, report-2.pdf … for which no file exists."""
    names = chain(["report.pdf"], (f"report-{n}.pdf" for n in count(2)))
    return next(name for name in names if not Path(name).exists())


def say_handout(paths: Sequence[Path] = (), answers: Path = REASONS, sinusoid: str = "") -> None:
    """Print the command of the handout's report, with the file `answers` if it exists.

    The report contains the given recordings, and others of the same origin.
    """
    answers_option = f" --answers {quote(str(answers))}" if answers.exists() else ""
    files, report = path_texts(_for_the_report(paths)), free_name()
    say_next("handout", files=files, answers=answers_option, sinusoid=sinusoid, report=report)


def path_texts(paths: Iterable[Path]) -> str:
    """Return the names of recordings, with a blank before each name."""
    return "".join(f" {command_line_name(path)}" for path in paths)


def _for_the_report(paths: Sequence[Path]) -> list[Path]:
    """Return the recordings for the handout's report: the given recordings, and others like them.

    The report uses a step, an estimation and a validation recording, and a recording of the
    chassis. All added recordings have the origin of the given recordings. If none is given, the
    origin is that of most of these recordings.
    """
    from armrig.recordings.files.origin import Origin, description_in
    from armrig.recordings.files.recording_summary import summary_of

    recordings = own_recordings()
    try:
        fixed = [summary_of(path) for path in paths]
    except (DamageError, OSError):  # nothing is known about an incomplete recording
        return list(paths)
    if fixed:
        origins = [Origin.of_summary(s) for s in fixed]
        taken = {path.absolute() for path in paths}
        alike = [s for s in recordings if all(origin.matches(s) for origin in origins)]
        alike = [s for s in alike if s.path.absolute() not in taken]
        return [s.path for s in _complete_set(fixed, alike)]
    groups, left = list[list["RecordingSummary"]](), recordings
    while left:
        origin, described = Origin.of_summary(left[0]), description_in(left[0].path)
        alike = [s for s in left if origin.matches(s)]
        left = [s for s in left if s not in alike]
        if described is not None and described.arm:
            groups.append(_complete_set([], alike))
    return [s.path for s in max(groups, key=len, default=[])]


def _complete_set(
    fixed: Sequence[RecordingSummary], alike: Sequence[RecordingSummary]
) -> list[RecordingSummary]:
    """Return the given recordings, completed from `alike`: step, pair, chassis, and others."""
    from armrig.report.handout_study import OTHERS

    steps, alone = ([s for s in fixed if s.kind == kind] for kind in ("step", "greybox"))
    excited = [s for s in fixed if s.kind not in OTHERS]
    if not excited:
        named_first = sorted(_pairs(alike, "blackbox"), key=lambda pair: not pair[1].name)
        excited = list(chain(*named_first[:1]))
    elif len(excited) == 1:
        pairs = _pairs([*excited, *alike])
        excited = next((list(pair) for pair in pairs if excited[0] in pair), excited)
    chosen = [*(steps or _newest("step", alike)), *excited, *(alone or _newest("greybox", alike))]
    return chosen + [s for s in fixed if s not in chosen]


def _newest(kind: str, recordings: Sequence[RecordingSummary]) -> list[RecordingSummary]:
    """Return the newest recording of a kind, if possible with a name; [] if there is none."""
    return sorted((s for s in recordings if s.kind == kind), key=lambda s: not s.name)[:1]


def chassis(origin: Origin | None) -> str:
    """Return the name of the newest complete recording of the chassis alone; "" if none exists."""
    alike = [s for s in own_recordings() if origin is None or origin.matches(s)]
    return "".join(command_line_name(s.path) for s in _newest("greybox", alike))


CHECK = ""
"""Result of `options_after` if the next command must be `armrig check`, which tests the data."""
_REJECTED = {"residuals", "search", "feedback"}
"""Codes of the findings after which a model of several signals is estimated again."""


def after_identify(outcome: IdentifyOutcome, findings: Sequence[Finding]) -> None:
    """Print the next command, which acts on the findings, saves the model or validates it."""
    fit, data, signals, columns = outcome.fit, outcome.data, outcome.signals, outcome.data.signals()
    siso = (fit.ny, fit.nu) == (1, 1)
    options, data_options, file = (
        options_after(outcome, findings),
        signals.options(),
        command_line_name(outcome.file),
    )
    validation = command_line_name(outcome.validate) if outcome.validate else ""
    if signals.read and not validation:
        validation = counterpart(outcome.file, "validation")
    output, input = (*signals.outputs, *columns.outputs)[0], (*signals.inputs, *columns.inputs)[0]
    channel = signals.of_channel(output, input, data)
    values: dict[str, str | float] = {
        "file": file,
        "Ts": data.Ts or fit.Ts,
        "validation": validation,
        "model": quote(str(outcome.save or "model.json")),
        "options": options + data_options + (f" --validate {validation}" if validation else ""),
        # `armrig check` has no option --offset.
        "given": channel.options() + " --detrend" * (siso and fit.offset and not signals.detrend),
    }
    roles = "".join(f" {typed}" for typed in signals.given("input", "signal"))
    # The next step after the validation of one output is known for the arm's angle alone.
    has_next = signals.read and (not siso or fit.output in INTEGRATING_OUTPUTS)
    if "rails" in {f.remedy for f in findings}:
        say_next("import", file=_original(outcome.file), given=roles)
    elif options == CHECK:
        say_next("check", **values)
    elif outcome.save is None or options != (outcome.search_options or options_of(outcome.request)):
        say_next("identify", **values)
    elif outcome.validate is not None and outcome.validation is not None and has_next:
        tests = outcome.validation.tests
        after_validate(fit, tests, data, outcome.validate, outcome.save, signals, estimation=file)
    elif siso and signals.read and (design := design_model_file(signals.read[0].path)):
        say_next("compare laws", **values | {"design": design})
    elif validation:
        # `armrig validate` has no option --assume.
        say_next("validate", **values | {"given": replace(signals, assume=None).options()})
    elif signals.read:  # other data end here: `check` would lead to hints, and to this model again
        say_next("collect blackbox", signals.origin, **values)


def design_model_file(recording: Path) -> str:
    """Return the quoted file of the model on which the law of a run was designed, if it exists.

    The hash of the model in the law must be that of the file. Otherwise the result is "".
    """
    from armrig.control.loop_comparison import model_path
    from armrig.control.plant import design_model
    from armrig.models.model_file import load_fit
    from armrig.recordings.files.control_run import law_of
    from armrig.recordings.files.loading import beginning

    with suppress(ArmrigError, OSError, ValueError):
        law = law_of(beginning(recording)[1].attachments)
        if law is not None:
            file = model_path(law)
            design = design_model(load_fit(Path(file)), Ts=law.Ts_us / 1e6)
            return quote(file) if design.sha256 == law.design.get("model_sha256") else ""
    return ""


def _original(file: Path) -> str:
    """Return the quoted name of a file, or of the file from which a recording was imported."""
    from armrig.recordings.files.imports import import_of

    facts = import_of(file) if file.suffix == RECORDING else None
    return quote(facts.sources[0].name if facts else str(file))


def after_validate(
    fit: Fit,
    tests: ResidualTest,
    data: Dataset | Signals,
    file: Path,
    model: Path,
    signals: SignalChoice,
    estimation: str = "",
) -> None:
    """Print the next command: a comparison with other models, or a test of one channel."""
    channel, recorded = signals, from_recording(data)
    if (fit.ny, fit.nu) == (1, 1):
        estimation = estimation or (counterpart(file, "estimation") if recorded else "")
        name = "compare" if estimation else "check"
    else:
        channel = signals.of_channel(*tests.poorest_pair, data)
        of_arm = from_arm(data) and not INTEGRATING_OUTPUTS.isdisjoint(fit.outputs)
        name = "simulate" if of_arm else "check"
    if name == "check" and not recorded:
        return  # `check` of other data leads to hints, and so to this model again
    part = SignalChoice(calibration=signals.calibration, start=signals.start, stop=signals.stop)
    values = {"file": command_line_name(file), "estimation": estimation, "model": quote(str(model))}
    say_next(name, **values, given=channel.options(data), part=part.options())


def options_after(outcome: IdentifyOutcome, findings: Sequence[Finding]) -> str:
    """Return the options with which `armrig identify` applies the remedies of the findings.

    The result is `CHECK` if the data must be tested first.
    """
    fit, request = outcome.fit, outcome.request
    if (fit.ny, fit.nu) != (1, 1):
        if outcome.search is None and any(f.remedy == "noise" for f in findings):
            return "--structure ss"
        return _of_several(outcome, {f.about for f in findings})
    kind = STRUCTURES[fit.structure]
    remedies = {f.remedy for f in findings}
    if "noise" in remedies and outcome.search is None:
        if kind.continuous:
            return options_of(structs.replace(request, two_stage=True))
        n = fit.denominator.size - 1
        orders = {"nb": fit.orders["nb"] if "nb" in kind.orders else n, "nc": 1, "nd": 1, "nf": n}
        return options_of(request.of_structure("bj", orders))
    checked = {f.about for f in findings if f.remedy == "check"}
    # A noise model prevents the bias by feedback.
    must_check = bool(checked - {"feedback"} or (checked and not kind.closed_loop))
    if outcome.search is not None:  # it compared levels, orders and delays on data held out
        outliers = "outliers" in remedies
        return (
            CHECK
            if must_check and not outliers
            else outcome.search_options + " --hampel" * outliers
        )
    if "structure" in remedies:
        oe = request.of_structure("oe", {"nb": fit.orders["nb"], "nf": fit.orders[kind.poles]})
        return options_of(structs.replace(oe, integrator=True, offset=False))
    # A constant level of y looks like an integrator. Angles are not tested for a level.
    level = "level" in remedies and not fit.integrator
    asked = "integrator" in remedies and not level
    integrator = (fit.integrator or asked) and "integrator" in kind.takes
    offset = (fit.offset or level) and "offset" in kind.takes and not (integrator or fit.integrator)
    detrend = level and not (offset or outcome.signals.detrend)
    # If the level was removed or estimated and is found again, the order is too high.
    seen = level and not detrend and offset == fit.offset
    form = f"{request.form}I" if request.form and asked else request.form
    after = structs.replace(request, integrator=integrator, offset=offset, form=form)
    if lags := [int(f.numbers["nk"]) for f in findings if f.remedy == "nk"]:
        after = structs.replace(after, **_later(after, lags[0]))
    if request.orders and ("order" in remedies or seen):
        many = max((int(f.numbers.get("poles", 1)) for f in findings), default=1)
        after = structs.replace(after, orders=_lower(fit, many, integrator=integrator))
    options = options_of(after) + " --detrend" * detrend + " --hampel" * ("outliers" in remedies)
    if options != options_of(request):
        return options
    if must_check:
        return CHECK
    if "search" in remedies and fit.structure in OFFERED and not request.two_stage:
        # The noise of a process model has no parameters: its colour is no reason for a pole more.
        if form and not _misses_dynamics(outcome):
            return options
        if form and ("D" not in form or form[1] < "3"):  # a dead time, or a time constant more
            richer = f"P{int(form[1]) + 1}{form[2:]}" if "D" in form else f"{form}D"
            return options_of(structs.replace(request, form=richer))
        return "--search" if kind.continuous else f"--structure {fit.structure} --search"
    return options


def _of_several(outcome: IdentifyOutcome, about: Set[str]) -> str:
    """Return the options of the next estimation of several signals; others only if rejected."""
    request, data = outcome.request, outcome.data
    rejected = outcome.validation is not None and outcome.validation.tests.rejects
    if outcome.search is not None or not (rejected or about & _REJECTED):
        return outcome.search_options or options_of(request)
    if not from_arm(data):
        may_offset = "offset" in STRUCTURES[request.structure].takes
        if has_level(data) and not request.offset:  # with the level the orders may fit
            levelled = structs.replace(request, offset=may_offset)
            return options_of(levelled) + " --detrend" * (not may_offset)
    elif not INTEGRATING_OUTPUTS.isdisjoint(data.signals().outputs) and not request.integrator:
        return "--structure oe --integrator"
    return CHECK if "feedback" in about else "--search"


def _later(request: Request, nk: int) -> dict[str, Any]:
    """Return the changes of a request with which the model begins at lag nk."""
    if request.form:
        return {"form": request.form if "D" in request.form else f"{request.form}D"}
    return {"delay": "estimate"} if STRUCTURES[request.structure].continuous else {"nk": nk}


def _misses_dynamics(outcome: IdentifyOutcome) -> bool:
    from armrig.numerics.whiteness import WHITE_LEVEL
    from armrig.validation.residuals import residuals

    tests = outcome.validation.tests if outcome.validation else residuals(outcome.fit, outcome.data)
    return bool(tests.missing_dynamics < WHITE_LEVEL)


def _lower(fit: Fit, many: int, *, integrator: bool) -> dict[str, int]:
    """Return the orders without the `many` cancelling poles; noise orders do not change."""
    least = {"nb": 1, "zeros": 0, STRUCTURES[fit.structure].poles: 1 + integrator}
    return {
        name: max(n - many, min(n, least[name])) if name in least else n
        for name, n in fit.orders.items()
        if name in STRUCTURES[fit.structure].orders
    }
