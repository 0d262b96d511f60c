"""Control laws that a person chooses on the page, from the folder of the recordings."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from armrig_core.commands.commands import StatusReport, samples_of
from armrig_core.control.control_law import ControlLaw, load_law
from armrig_core.errors import ArmrigError, FileError, InputError
from armrig_core.process.printable import printable, with_degrees
from armrig_core.recording_file.recording_directory import configuration_files, directory_to_look_in
from msgspec.structs import replace

from armrig.excitation.reference import profile_of
from armrig.recordings.files.catalogue import catalogue
from armrig.recordings.files.control_run import law_of
from armrig.recordings.files.loading import beginning

_MOST_FILES, _MOST_RUNS = 50, 10
_MAX_METHOD = 40  # characters


def recordings_folder(status: StatusReport | None, rig: str) -> Path:
    """Return the daemon's folder of recordings; if it is unreadable, that of `armrig ls`."""
    if status and os.access(status.recordings, os.R_OK | os.X_OK):
        return Path(status.recordings)
    return directory_to_look_in(configuration_files(rig), os.environ)


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


def law_rows(folder: Path, status: StatusReport) -> list[dict[str, Any]]:
    """Return the JSON files of a folder, with `why` each cannot be used, and the recorded laws."""
    found = [path for path in folder.glob("*.json") if path.is_file()]
    newest = sorted(found, key=lambda path: -path.stat().st_mtime)[:_MOST_FILES]
    runs = [s.file for s in catalogue(folder).recordings if s.kind == "control"]
    recorded = [_row(folder, file, status) for file in runs[:_MOST_RUNS]]
    files = [_row(folder, path.name, status) for path in newest]
    return files + [row for row in recorded if not row["why"]]


def _row(folder: Path, file: str, status: StatusReport) -> dict[str, Any]:
    try:
        law = read_law(folder, file)
        check_fits(law, status)
    except ArmrigError as err:
        return {"file": file, "why": str(err).removeprefix(f"{folder / file}: ")}
    r, profile = law.reference, profile_of(law, "step")
    return {
        "file": file,
        "why": "",
        "sha256": law.sha256,
        "method": printable(str(law.design.get("method", ""))[:_MAX_METHOD]),
        "reference": replace(r, unit=with_degrees(r.unit)),
        "levels": (profile.low, profile.high),
        "monitored": law.monitor is not None,
    }
