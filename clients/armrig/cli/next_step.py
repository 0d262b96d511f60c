"""The path of the handout: what a person types next, ready to copy."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import count, islice
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

from armrig_core.printable import printable

if TYPE_CHECKING:
    from armrig.recordings.recording import Recording
    from armrig.recordings.recording_summary import RecordingSummary

_LONGEST = 28
"""Letters of a name that another word is put behind."""
_AGAIN = "-again"
"""Ending of the name of a step that is made again."""
_MOST_READ = 100
"""Recordings of a kind that are looked at."""

AFTER: Mapping[str, str] = {
    "lab": "armrig collect step{rig} --Ts 0.002 --seconds 10 --name first",
    "lab chassis": "armrig collect greybox{rig} --Ts 0.01 --seconds 30 --seed 3 --name chassis",
    "flash": "armrig conformance --device {port}",
    "model": "armrig model --set J_2=0.005 --set K_lin=2.4 -o step.png",
    "model --set": "armrig lab",
    "calibrate": "armrig collect step{rig} --Ts 0.002 --seconds 10 --name first",
    "status": "armrig collect step{rig} --Ts 0.002 --seconds 10 --name first",
    "status chassis": "armrig collect greybox{rig} --Ts 0.01 --seconds 30 --seed 3 --name chassis",
    "demo": "armrig plot {file} -o data.png",
    "stop": "armrig status{rig}",
    "reset": "armrig status{rig}",
    "ls": "armrig info {file}",
    "info": "armrig plot {file}",
    "play": "armrig info {file}",
    "record": "armrig info {file}",
    "collect step": "armrig sampling {file} -o sampling.png",
    "step hidden": "armrig collect step{again}",
    "sampling": "armrig collect blackbox --Ts {Ts:g} --seconds 30 --validation",
    "sampling other": "armrig hints {file}{given} -o hints.png",
    "collect blackbox": "armrig plot {file}",
    "collect greybox": "armrig greybox {file} -o chassis.png",
    "collect staircase": "armrig plot {file}",
    "collect bla": "armrig plot {file}",
    "plot": "armrig hints {file} -o hints.png",
    "plot step": "armrig sampling {file} -o sampling.png",
    "plot greybox": "armrig greybox {file}",
    "hints": "armrig identify {file} {options}{validate} --save model.json",
    "identify": "armrig identify {file} {options} --save {model}",
    "identify --save": "armrig validate {validation} --model {model}{given} -o validate.png",
    "identify check": "armrig check {file}{given}",
    "identify alone": "armrig collect blackbox --Ts {Ts:g} --seconds 30 --seed 2",
    "validate": "armrig compare {estimation} {file} --model {model} -o compare.png",
    "validate alone": "armrig check {file}{given}",
    "compare": "armrig check {file}{given}",
    "simulate": "armrig lab",
    "simulate F": "armrig check {file}{given}",
    "check": "armrig lab --config chassis.toml",
    "check with chassis": "armrig greybox {chassis} -o chassis.png",
    "check greybox": "armrig integrate -o integrate.png",
    "check other": "armrig hints {file}{given} -o hints.png",
    "greybox": "armrig split {file}{given} -o split.png",
    "split": "armrig integrate -o integrate.png",
    "integrate": "armrig report --handout{files}{answers}{sinusoid} -o {report}",
    "report": "{opener} {file}",
    "report --source": "armrig report --from {source} -o {report}",
}
"""The line after each command, with what stands in braces filled in."""


def say_next(after: str, **values: str | float) -> None:
    """Print the line after a command, beside what was asked for."""
    say_to_copy(next_line(after, **values))


def say_to_copy(text: str) -> None:
    """Print what a person may copy, beside what was asked for: its lines are not folded."""
    with suppress(OSError):  # the terminal may be closed
        print(printable(text, keep="\n"), file=sys.stderr)


def next_line(after: str, **values: str | float) -> str:
    """Return the line after a command."""
    return f"next: {printable(_goes_on(AFTER[after].format(**values)))}"


def _goes_on(line: str) -> str:
    """Return the line, or what comes after it where there is a whole recording of its name.

    A second one of the name would leave nobody able to say which of them is meant.
    """
    words = shlex.split(line)
    if words[1] != "collect" or words[-2] != "--name":
        return line
    from armrig.cli.chosen_recording import (
        NoSuchRecordingError,
        matching,
        recording_folder,
    )
    from armrig.recordings.folder import newest_first

    try:
        paths = newest_first(recording_folder())
    except (NoSuchRecordingError, OSError):
        return line
    names = (f"@{words[-1]}{_AGAIN}", f"@{words[-1]}")  # what was made again replaces the first
    found = [s for name in names for s in matching(name, paths) if s.is_complete]
    if not found:
        return line
    after = f"collect {found[0].kind}"
    return AFTER[after if after in AFTER else "plot"].format(file=typed(found[0].path))


def step_again(recording: Recording) -> str:
    """Return the options of the step that shows what a dead band has hidden; "" where it has not.

    Where the chassis rests before the step, no time is better than another: it is to be turned.
    """
    from armrig.recordings.findings import hidden_step

    manifest = recording.manifest
    kind, _, name = manifest.experiment.partition("-")
    hidden = hidden_step(recording) if kind == "step" else None
    if hidden is None or not isfinite(hidden.at_s):
        return ""
    named = f" --name {shlex.quote(f'{name[:_LONGEST]}{_AGAIN}')}" if name else ""
    when = f" --at {hidden.at_s:g} --seconds {hidden.seconds:g}"
    return f" --Ts {manifest.Ts:g}{when}{named}"


def opener() -> str:
    """Return the program that opens a file as a double click does."""
    return {"darwin": "open", "win32": "start"}.get(sys.platform, "xdg-open")


def naming(rig: str, connect: str | None = None) -> str:
    """Return the options that name a rig, as typed behind a command; "" for the usual one."""
    named = "" if rig == "1" else f" --rig {rig}"
    return f"{named} --connect {shlex.quote(connect)}" if connect else named


def typed(path: Path) -> str:
    """Return a recording as a person would type it: its @name where it has one, or its path."""
    from armrig_core.recording_file.budget import DamageError

    from armrig.cli.chosen_recording import (
        NoSuchRecordingError,
        matching,
        recording_folder,
        short_name,
    )
    from armrig.recordings.folder import newest_first
    from armrig.recordings.recording_summary import summary_of

    try:
        folder = recording_folder()
        if path.absolute().parent == folder.absolute():
            paths = newest_first(folder)
            return short_name(summary_of(path), lambda name: matching(name, paths))
    except (NoSuchRecordingError, DamageError, OSError):
        pass
    return shlex.quote(str(path))


def estimation_of(path: Path) -> str:
    """Return the recording that one validates, as typed; "" where it does not say."""
    name = typed(path)
    if not name.startswith("@"):
        return ""
    from armrig.recordings.recording_summary import summary_of

    of = summary_of(path).validation_of
    return _named(f"@{of}") if of else ""


def _named(text: str) -> str:
    """Return the short name of the recording that an id means; the id where it is not there."""
    from armrig.cli.chosen_recording import NoSuchRecordingError, chosen, recording_folder

    try:
        return typed(chosen(text, recording_folder()).path)
    except NoSuchRecordingError:
        return text


def kind_of(path: Path) -> str:
    """Return the kind of experiment of a recording; "" where it does not say."""
    from armrig_core.recording_file.budget import DamageError

    from armrig.recordings.recording_summary import summary_of

    try:
        return summary_of(path).kind
    except (DamageError, OSError):
        return ""


def free_name() -> str:
    """Return the first of report.pdf, report-2.pdf … that no file here has."""
    free = (n for n in count(2) if not Path(f"report-{n}.pdf").exists())
    return f"report-{next(free)}.pdf" if Path("report.pdf").exists() else "report.pdf"


def for_the_report() -> str:
    """Return the recordings of the handout's report, as typed: step, pair and chassis.

    They are complete and of one calibration, the one that most of the four have; of each kind the
    newest one with a name, else the newest. With a blank before each; "" if there is none.
    """
    from armrig.cli.chosen_recording import NoSuchRecordingError, recording_folder
    from armrig.recordings.folder import newest_first

    try:
        paths = newest_first(recording_folder())
    except NoSuchRecordingError:
        return ""
    parts = ("-validation", "greybox", "step")
    every = {s.path: s for part in parts for s in _complete(paths, part)}
    calibrations = dict.fromkeys(s.calibration_sha256 for s in every.values())
    found = (_of_calibration(hash_, list(every.values())) for hash_ in calibrations)
    return "".join(f" {typed(s.path)}" for s in max(found, key=len, default=[]))


def _of_calibration(hash_: str, every: Sequence[RecordingSummary]) -> list[RecordingSummary]:
    """Return step, pair and chassis of a calibration, as far as there are any."""
    known = [s for s in every if s.calibration_sha256 == hash_]
    step, chassis = (_newest(s for s in known if s.kind == kind) for kind in ("step", "greybox"))
    pairs = (s for s in known if s.kind == "blackbox" and s.is_validation)
    validation = _newest(s for s in pairs if _estimation(s))
    estimation = _estimation(validation) if validation else None
    return [s for s in (step, estimation, validation, chassis) if s is not None]


def answers_here() -> str:
    """Return the option with the answers that the pages have one write, "" without the file."""
    return " --answers reasons.toml" if Path("reasons.toml").exists() else ""


def chassis() -> str:
    """Return the newest complete recording of the chassis alone, as typed; "" if there is none."""
    from armrig.cli.chosen_recording import NoSuchRecordingError, recording_folder
    from armrig.recordings.folder import newest_first

    try:
        every = _complete(newest_first(recording_folder()), "greybox")
        found = _newest(s for s in every if s.kind == "greybox")
    except (NoSuchRecordingError, OSError):
        return ""
    return typed(found.path) if found else ""


def _complete(paths: Sequence[Path], part: str) -> Iterator[RecordingSummary]:
    """Give the newest complete recordings whose file names contain a text."""
    from armrig.recordings.folder import summaries

    found = islice((path for path in paths if part in path.name), _MOST_READ)
    return (s for path in found for s in summaries([path]) if s.is_complete)


def _newest(found: Iterator[RecordingSummary]) -> RecordingSummary | None:
    """Return the first recording that a person named, else the first of all."""
    first = None
    for summary in found:
        if summary.name:
            return summary
        first = first or summary
    return first


def _estimation(validation: RecordingSummary) -> RecordingSummary | None:
    """Return the complete recording that one was made to validate.

    None where its sampling time or its calibration is another.
    """
    from armrig.cli.chosen_recording import NoSuchRecordingError, chosen

    try:
        found = chosen(f"@{validation.validation_of}", validation.folder)
    except NoSuchRecordingError:
        return None
    same = found.Ts == validation.Ts and found.calibration_sha256 == validation.calibration_sha256
    return found if same and found.is_complete else None


def validation_beside(path: Path) -> str:
    """Return the recording that validates what one gives, as typed; "" where there is none."""
    from armrig.cli.chosen_recording import (
        VALIDATION,
        NoSuchRecordingError,
        chosen,
        recording_folder,
    )

    name = typed(path)
    if not name.startswith("@"):
        return ""
    try:
        chosen(f"{name}{VALIDATION}", recording_folder())
    except NoSuchRecordingError:
        return ""
    return f"{name}{VALIDATION}"
