"""Imported recordings: the facts of an import, and the search for the import of a file."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import msgspec
import numpy as np
from armrig_core.errors import FileError
from armrig_core.process.bounded import read_bounded
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.manifest import OUTCOME, RUN, Manifest, Outcome
from armrig_core.rig.channels import MAX_CHANNELS, sample_names
from armrig_core.rig.description import Description, Input, Output, RigTable

from armrig.data.files import IMPORTED
from armrig.data.files.imported_file import Import, ImportedData, import_in, read_imported
from armrig.data.files.loading import MOST_BYTES, naming_file
from armrig.numerics.quantities import join_names
from armrig.recordings.files.catalogue import newest_first
from armrig.recordings.files.recording_names import NoSuchRecordingError, name_of, recording_folder
from armrig.recordings.files.recording_summary import read_metadata
from armrig.recordings.files.sample_rows import SAMPLE_DTYPE
from armrig.recordings.recording import Channel, Recording

_NO_STEP = 1e-12
"""Change of a value by one count, of data without a converter."""


def import_of(path: Path) -> Import | None:
    """Return the facts of an imported recording; None for any other file."""
    try:
        metadata = read_metadata(path).get(RUN)
        return import_in(Manifest.of(metadata)) if metadata else None
    except (DamageError, FileError, OSError, msgspec.MsgspecError, ValueError, RecursionError):
        return None


def load_import(path: Path) -> ImportedData | None:
    """Return the columns of an imported recording; None for any other file.

    Raises FileError if the imported recording is damaged.
    """
    if import_of(path) is None:
        return None
    with naming_file(path):
        return read_imported(read_bounded(path, MOST_BYTES))


def recording_of(path: Path, name: str, data: ImportedData) -> Recording:
    """Return imported data of one input and one or two outputs as a recording without a rig.

    The description has the names and units of the columns. The samples have no readings and no
    times of a device.

    Raises FileError if the import does not know one input and one or two outputs.
    """
    columns = data.on_grid()
    units = {c.name: rig_unit(c.unit) for c in data.facts.columns}
    inputs, outputs = data.facts.roles()
    if len(inputs) != 1 or not 1 <= len(outputs) <= MAX_CHANNELS:
        raise FileError(
            f"{path}: which of {join_names([*units])} are the input and the one or two outputs? "
            "Import the file again with --input NAME --signal NAME"
        )
    description = Description(
        rig=RigTable(name=IMPORTED, title=", ".join(s.name for s in data.facts.sources)[:60]),
        input=Input(name=rig_name(inputs[0], "input"), unit=units[inputs[0]]),
        outputs={rig_name(x): Output(unit=units[x], per_count=_NO_STEP) for x in outputs},
        model=None,
        text=b"",
    )
    metadata = read_metadata(path)
    if OUTCOME not in metadata:
        raise FileError(f"{path}: is damaged (it has no outcome); import the original file again")
    present = np.zeros(data.size, np.bool_)
    present[data.at] = True
    channels = {rig_name(x): Channel(columns[x], np.isfinite(columns[x])) for x in outputs}
    names = sample_names(description.channels)
    kinds = [(x, SAMPLE_DTYPE[i]) for i, x in enumerate(names)]
    return Recording(
        path=path,
        name=name,
        sha256=hashlib.sha256(path.read_bytes()).hexdigest(),
        manifest=Manifest.of(metadata[RUN]),
        outcome=Outcome.of(metadata[OUTCOME]),
        t=data.Ts * np.arange(data.size, dtype=np.float64),
        u=columns[inputs[0]],
        channels=channels,
        description=description,
        present=present,
        turns_unknown=data.facts.breaks,
        samples=np.zeros(len(data.at), kinds),
    )


def rig_name(column: str, what: str = "output") -> str:
    """Return the name of a column as a rig's description may have it."""
    name = re.sub(r"\W+", "_", column, flags=re.A).strip("_")[:32]
    return name if re.match("[A-Za-z]", name) else f"{what}_{name}"[:32]


def rig_unit(unit: str) -> str:
    """Return a unit as a rig's description may have it."""
    return "".join(c for c in unit.replace("$", "dollar") if c.isprintable())[:80]


def require_rig(path: Path, command: str) -> None:
    """Refuse imported data, which belong to no rig."""
    if import_of(path) is not None:
        raise FileError(
            f"{path}: was imported, and `armrig {command}` needs a recording of a rig; "
            "`armrig info` shows what was imported"
        )


def name_of_import(sha256: str) -> str:
    """Return the @NAME of the newest import of a file with this hash; "" if there is none."""
    try:
        folder = recording_folder()
    except NoSuchRecordingError:
        return ""
    for path in newest_first(folder):
        if not path.name.startswith(f"{IMPORTED}-"):
            continue
        facts = import_of(path)
        if facts and sha256 in {source.sha256 for source in facts.sources}:
            return name_of(path)
    return ""
