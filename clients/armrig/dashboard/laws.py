"""Control laws that a person chooses on the page, from the folder of the recordings."""

from __future__ import annotations

import os
from pathlib import Path

import msgspec
from armrig_core.commands.commands import StatusReport, samples_of
from armrig_core.control.control_law import ControlLaw, load_law
from armrig_core.errors import ArmrigError, FileError, InputError
from armrig_core.process.printable import printable, with_degrees
from armrig_core.recording_file.recording_directory import directory_to_look_in, installed

from armrig.excitation.reference import profile_of
from armrig.recordings.files.catalogue import catalogue
from armrig.recordings.files.control_run import law_of
from armrig.recordings.files.loading import beginning

_MOST_FILES, _MOST_RECORDINGS = 50, 10
_MAX_METHOD = 40  # characters


class LawRow(msgspec.Struct, frozen=True, kw_only=True):
    """A file of the folder that may be a law."""

    file: str
    why: str = ""
    """Reason why the law cannot be used; "" for a law that fits the rig."""
    sha256: str = ""
    method: str = ""
    """Method of the design."""
    name: str = ""
    """Name of the variable that follows r."""
    unit: str = ""
    low: float = 0.0
    """Lowest value of r, in its unit."""
    high: float = 0.0
    """Highest value of r, in its unit."""
    span: float = 1.0
    """Width of the range of r."""
    levels: tuple[float, float] = (0.0, 0.0)
    """Lowest and highest level of a step, if they are not given."""
    Ts: float = 0.0
    """Sampling time, in s."""
    monitored: bool = True
    """True if the law has a monitor."""


def recordings_folder(status: StatusReport | None, rig: str) -> Path:
    """Return the daemon's folder of recordings; if it is unreadable, that of `armrig ls`."""
    if status and os.access(status.recordings, os.R_OK | os.X_OK):
        return Path(status.recordings)
    return directory_to_look_in(installed(rig), os.environ)


def file_in(folder: Path, file: str, *endings: str) -> Path:
    """Return the path of a file in a folder; refuse a link, another folder and other endings."""
    path = folder / file
    is_name = Path(file).name == file and file.endswith(endings)
    if not is_name or path.is_symlink() or not path.is_file():
        raise InputError(f"{file!r}: there is no such file in {folder}")
    return path


def read_law(folder: Path, file: str) -> ControlLaw:
    """Return the law in a file of a folder, or the law of a recording.

    Raises InputError if the file is none, cannot be read, or has no law.
    """
    path = file_in(folder, file, ".json", ".mcap")
    if path.suffix == ".json":
        return load_law(path)
    try:
        law = law_of(beginning(path)[1].attachments)
    except OSError as err:
        raise FileError(f"{path}: {err.strerror}") from err
    if law is None:
        raise InputError(f"{file}: the recording has no law")
    return law


def check_fits(law: ControlLaw, status: StatusReport) -> None:
    """Raise InputError if the rig cannot run a law."""
    rig, Ts = status.described, law.Ts_us / 1e6
    every = samples_of(Ts, rig.longest_sample_s)
    law.check_rig(rig, round(law.Ts_us / every), status.u_min, status.u_max)


def law_rows(folder: Path, status: StatusReport) -> list[LawRow]:
    """Return the JSON files of a folder and the recorded laws, those that fit the rig first."""
    newest = sorted(
        (path for path in folder.glob("*.json") if path.is_file()),
        key=lambda path: path.stat().st_mtime,
        reverse=True,
    )
    runs = [s.file for s in catalogue(folder).recordings if s.kind == "control"]
    files = [path.name for path in newest[:_MOST_FILES]] + runs[:_MOST_RECORDINGS]
    rows = [_row(folder, file, status) for file in files]
    return sorted(rows, key=lambda row: bool(row.why))


def _row(folder: Path, file: str, status: StatusReport) -> LawRow:
    try:
        law = read_law(folder, file)
        check_fits(law, status)
    except ArmrigError as err:
        return LawRow(file=file, why=str(err).removeprefix(f"{folder / file}: "))
    r, profile = law.reference, profile_of(law, "step")
    return LawRow(
        file=file,
        sha256=law.sha256,
        method=printable(str(law.design.get("method", ""))[:_MAX_METHOD]),
        name=r.name,
        unit=with_degrees(r.unit),
        low=r.low,
        high=r.high,
        span=r.high - r.low or 1.0,
        levels=(profile.low, profile.high),
        Ts=law.Ts_us / 1e6,
        monitored=law.monitor is not None,
    )
