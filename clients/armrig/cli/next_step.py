"""Next commands in the order of the handout, ready to copy."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import count, islice
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

from armrig_core.errors import ArmrigError
from armrig_core.process.printable import printable
from armrig_core.recording_file.budget import DamageError

if TYPE_CHECKING:
    from armrig.recordings.recording import Recording
    from armrig.recordings.recording_summary import RecordingSummary


_MAX_NAME_LENGTH = 28
"""Largest number of letters of a name before the suffix `_AGAIN`; further letters are cut off."""
_AGAIN = "-again"
"""Suffix of the name of a repeated step."""
_MAX_SEARCHED = 100
"""Largest number of recordings, newest first, that are searched for a kind of experiment."""

AFTER: Mapping[str, str] = {
    "lab": "armrig collect step{rig} --Ts 0.002 --seconds 10 --name first",
    "lab chassis": "armrig collect greybox{rig} --Ts 0.01 --seconds 30 --seed 3 --name chassis",
    "flash": "armrig conformance --device {port}",
    "model": "armrig model --set J_2=0.005 --set K_lin=2.4 -o step.png",
    "model --set": "armrig lab",
    "calibrate": "armrig collect step{rig} --Ts 0.002 --seconds 10 --name first",
    "status": "armrig collect step{rig} --Ts 0.002 --seconds 10 --name first",
    "status chassis": "armrig collect greybox{rig} --Ts 0.01 --seconds 30 --seed 3 --name chassis",
    "demo": "{opener} {file}",
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
    "validate several": "armrig simulate {file} --model {model}{part} -o simulate.png",
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
    "report --questions": "armrig report --handout --questions {questions}",
    "report --source": "armrig report --from {source} -o {report}",
}
"""Next command after each command; names in braces are replaced by values."""
REASONS = "reasons.toml"
"""Usual name of the file with the answers to the handout's questions."""


def say_next(after: str, **values: str | float) -> None:
    """Print the line `next: …` after a command, on standard error."""
    say_to_copy(next_line(after, **values))


def say_to_copy(text: str) -> None:
    """Print lines to copy on standard error, without folding."""
    with suppress(OSError):  # the terminal may be closed
        print(printable(text, keep="\n"), file=sys.stderr)


def next_line(after: str, **values: str | float) -> str:
    """Return the line `next: …` after a command."""
    return f"next: {printable(_goes_on(AFTER[after].format(**values)))}"


def _goes_on(line: str) -> str:
    """Return the command, or a later command if the result of this command already exists.

    The result is a running rig, or a complete recording. A second complete recording with the same
    --name would make the name ambiguous.
    """
    words = shlex.split(line)
    if words[1:] == ["lab"] and _rig_runs():
        return _goes_on(AFTER["lab"].format(rig=""))
    if words[1] == "collect" and "--validation" in words:
        pair = recorded_pair(float(words[words.index("--Ts") + 1]))
        return AFTER["collect blackbox"].format(file=pair) if pair else line
    if words[1] != "collect" or words[-2] != "--name":
        return line
    from armrig.recordings.recording_names import matching

    paths = own_recordings()
    names = (f"@{words[-1]}{_AGAIN}", f"@{words[-1]}")  # prefer the repeated run
    found = [s for name in names for s in matching(name, paths) if s.is_complete]
    if not found:
        return line
    if found[0].kind == "step" and (pair := recorded_pair()):
        return AFTER["plot"].format(file=pair)
    after = f"collect {found[0].kind}"
    return AFTER[after if after in AFTER else "plot"].format(file=typed(found[0].path))


def _rig_runs() -> bool:
    """Return True if a daemon of rig 1 has its socket on this machine."""
    with suppress(ImportError, ArmrigError):  # not on Windows
        from armrig.rig.session import local_rigs

        return "1" in local_rigs()
    return False


def recorded_pair(Ts: float | None = None) -> str:
    """Return the newest estimation recording with a validation recording; "" if none exists."""
    pairs = map(_estimation, _complete(own_recordings(), "blackbox-validation"))
    found = next((s for s in pairs if s and Ts in (None, s.Ts)), None)
    return typed(found.path) if found else ""


def own_recordings() -> list[Path]:
    """Return the paths in the recording folder, newest first; none if it cannot be read."""
    from armrig.recordings.catalogue import newest_first
    from armrig.recordings.recording_names import NoSuchRecordingError, recording_folder

    try:
        return newest_first(recording_folder())
    except (NoSuchRecordingError, OSError):
        return []


def step_again(recording: Recording) -> str:
    """Return the options that repeat a step if the dead band hid its rise; otherwise "".

    If the chassis rests before the step, a step at another time does not show the rise either. The
    result is then "", because the user must turn the chassis by hand.
    """
    from armrig.recordings.findings import hidden_step

    manifest = recording.manifest
    kind, _, name = manifest.experiment.partition("-")
    hidden = hidden_step(recording) if kind == "step" else None
    if hidden is None or not isfinite(hidden.at_s):
        return ""
    named = f" --name {shlex.quote(f'{name[:_MAX_NAME_LENGTH]}{_AGAIN}')}" if name else ""
    when = f" --at {hidden.at_s:g} --seconds {hidden.seconds:g}"
    return f" --Ts {manifest.Ts:g}{when}{named}"


def opener() -> str:
    """Return the program that opens a file as a double click does."""
    return {"darwin": "open", "win32": "start"}.get(sys.platform, "xdg-open")


def naming(rig: str, connect: str | None = None) -> str:
    """Return the options that name a rig and its endpoint; "" for the defaults."""
    named = "" if rig == "1" else f" --rig {rig}"
    return f"{named} --connect {shlex.quote(connect)}" if connect else named


def typed(path: Path) -> str:
    """Return the @name of a recording, or its quoted path, as a user types it."""
    from armrig.recordings.catalogue import newest_first
    from armrig.recordings.recording_names import (
        NoSuchRecordingError,
        matching,
        recording_folder,
        short_name,
    )
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
    """Return the @name of the estimation recording of a validation recording; "" if unknown."""
    name = typed(path)
    if not name.startswith("@"):
        return ""
    from armrig.recordings.recording_summary import summary_of

    if not (of := summary_of(path).validation_of):
        return ""
    found = _chosen(f"@{of}")  # without such a recording, the id is its name
    return typed(found.path) if found else f"@{of}"


def _chosen(text: str, folder: Path | None = None) -> RecordingSummary | None:
    """Return the recording that a name means; None if the name is unknown or ambiguous."""
    from armrig.recordings.recording_names import NoSuchRecordingError, chosen, recording_folder

    try:
        return chosen(text, folder or recording_folder())
    except NoSuchRecordingError:
        return None


def kind_of(path: Path) -> str:
    """Return the kind of experiment of a recording; "" if the file cannot be read."""
    from armrig.recordings.recording_summary import summary_of

    try:
        return summary_of(path).kind
    except (DamageError, OSError):
        return ""


def free_name() -> str:
    """Return the first name of report.pdf, report-2.pdf … for which no file exists."""
    free = (n for n in count(2) if not Path(f"report-{n}.pdf").exists())
    return f"report-{next(free)}.pdf" if Path("report.pdf").exists() else "report.pdf"


def for_the_report() -> str:
    """Return the names of the recordings for the handout's report, with a blank before each name.

    The report uses four complete recordings: step, estimation, validation, chassis. The first three
    have the same calibration. The function chooses the calibration with which most of these four
    recordings were made. Of each kind, it takes the newest recording that has a name of the user.
    If no recording of this kind has a name, it takes the newest one. The result is "" if there is
    no recording.
    """
    paths = own_recordings()
    parts = ("-validation", "greybox", "step")
    every = {s.path: s for part in parts for s in _complete(paths, part)}
    calibrations = dict.fromkeys(s.calibration_sha256 for s in every.values())
    found = (_of_calibration(hash_, list(every.values())) for hash_ in calibrations)
    return "".join(f" {typed(s.path)}" for s in max(found, key=len, default=[]))


def _of_calibration(hash_: str, every: Sequence[RecordingSummary]) -> list[RecordingSummary]:
    """Return the existing step, estimation, validation and chassis recordings of a calibration."""
    known = [s for s in every if s.calibration_sha256 == hash_]
    step = _newest(s for s in known if s.kind == "step")
    # A daemon for the chassis alone reads the same calibration from a file, with another hash.
    either = (_newest(s for s in of if s.kind == "greybox") for of in (known, every))
    chassis = next(filter(None, either), None)
    pairs = (s for s in known if s.kind == "blackbox" and s.is_validation)
    validation = _newest(s for s in pairs if _estimation(s))
    estimation = _estimation(validation) if validation else None
    return [s for s in (step, estimation, validation, chassis) if s is not None]


def answers_here() -> str:
    """Return the option `--answers reasons.toml` if this file exists; otherwise ""."""
    return f" --answers {REASONS}" if Path(REASONS).exists() else ""


def chassis() -> str:
    """Return the name of the newest complete recording of the chassis alone; "" if none exists."""
    found = _newest(s for s in _complete(own_recordings(), "greybox") if s.kind == "greybox")
    return typed(found.path) if found else ""


def _complete(paths: Sequence[Path], part: str) -> Iterator[RecordingSummary]:
    """Yield the newest complete recordings whose file names contain `part`."""
    from armrig.recordings.catalogue import summaries

    found = islice((path for path in paths if part in path.name), _MAX_SEARCHED)
    return (s for path in found for s in summaries([path]) if s.is_complete)


def _newest(found: Iterator[RecordingSummary]) -> RecordingSummary | None:
    """Return the first recording with a name, or the first recording if none has a name."""
    first = None
    for summary in found:
        if summary.name:
            return summary
        first = first or summary
    return first


def _estimation(validation: RecordingSummary) -> RecordingSummary | None:
    """Return the complete estimation recording of a validation recording.

    None if the sampling time or the calibration differs.
    """
    found = _chosen(f"@{validation.validation_of}", validation.folder)
    if found is None:
        return None
    same = found.Ts == validation.Ts and found.calibration_sha256 == validation.calibration_sha256
    return found if same and found.is_complete else None


def validation_beside(path: Path) -> str:
    """Return the name of the validation recording of an estimation recording; "" if none exists."""
    from armrig.recordings.recording_names import VALIDATION

    beside = f"{typed(path)}{VALIDATION}"
    return beside if beside.startswith("@") and _chosen(beside) else ""
