"""The command import: foreign files become a recording."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any, Literal

from armrig_core.errors import InputError
from armrig_core.process.options import argument, group, preset

from armrig.cli.next_step import free_recording_name, say_next
from armrig.cli.options import Json, Verbose
from armrig.cli.printing import print_json, print_table, some, spinner
from armrig.cli.recorded_data import names
from armrig.cli.results import check_output, whole_file
from armrig.cli.runs import check_name_is_free, experiment_name
from armrig.data.files import IMPORTED
from armrig.data.finding import few_samples
from armrig.data.step import DOUBT
from armrig.numerics.quantities import plural

if TYPE_CHECKING:
    from armrig.data.files.imported_file import ImportedData

Files = Annotated[
    list[Path],
    argument("FILE…", "Files of one experiment: tables of text, .mat, .npz, .parquet or .mcap."),
]
_MAX_NAME = 20
_MAX_SHOWN = 12  # columns without --verbose
_STAMP = "%Y%m%dT%H%M%S"


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadingOptions:
    """Options of reading foreign files."""

    input: str | None = preset(
        None,
        "Column of an input: its name, or its number from 1.",
        "u, if there is it",
        metavar="NAME",
    )
    signal: str | None = preset(None, "Column of an output.", "y, if there is it", metavar="NAME")
    time: str | None = preset(
        None, "Column of the times.", "t or time, if the file has it", metavar="NAME"
    )
    Ts: float | None = preset(None, "Sampling time, in s.", "from the times")
    topic: str | None = preset(
        None,
        "Topic of an MCAP file of another program; its messages' fields are the columns.",
        metavar="NAME",
    )
    decimal: Literal[",", "."] | None = preset(
        None, "Decimal mark: comma or point.", "found from all numbers of the file"
    )
    resample: bool = preset(False, "Interpolate rows at uneven times; needs --input.")
    hold_input: bool = preset(False, "Hold the input where its cell is empty.")
    mask_rails: bool = preset(False, "Mark samples at a rail of the converter as missing.")
    unwrap: float | None = preset(
        None,
        "Range of a counter or angle that wraps, such as 65536 or 360; its jumps are removed.",
        metavar="RANGE",
    )


def import_(
    files: Files,
    reading: Annotated[
        dict[str, Any], group(ReadingOptions, made=dict, repeatable=("input", "signal"))
    ],
    name: str | None = preset(None, "Name of the recording, as in @NAME.", "the file's name"),
    out: Path | None = preset(
        None,
        "MCAP file to write.",
        "a file in the folder of the recordings",
        names="-o --out",
        metavar="MCAP",
    ),
    json: Json = False,
    verbose: Verbose = False,
) -> None:
    """Read data of another program, and write a recording.

    The command prints what it read: columns, units, times, gaps and what it left out. Each other
    command then reads the recording, @NAME, without a question. With several files, the rows have
    the times of the output.
    """
    from armrig.data.files.importing import import_files
    from armrig.data.files.placement import Reading
    from armrig.recordings.files.recording_names import recording_folder

    inputs, outputs = (
        names(f"--{role}", ",".join(reading.pop(role) or ())) for role in ("input", "signal")
    )
    if name is None:
        name = _name_like(files[0])
    else:
        experiment_name(IMPORTED, name)
        check_name_is_free(name)
    with spinner("reading"):
        data = import_files(files, Reading(**reading), inputs=inputs, outputs=outputs)
    run_id, file = _write(data, name, out, files)
    called = f"@{name}" if file.parent == recording_folder() else str(file)
    if json:
        print_json(import_facts(data) | {"recording": file, "name": name, "run_id": run_id})
        return
    print_table(*import_rows(data, called, file, verbose=verbose), verdict=True)
    say_next("hints" if all(data.facts.roles()) else "plot", file=quote(called), given="")


def _name_like(file: Path) -> str:
    """Return a free name of a recording like the name of a file."""
    name = re.sub(r"[^a-z0-9]+", "-", file.stem.lower())[:_MAX_NAME].strip("-") or "data"
    is_reserved = name in ("last", "validation") or name.startswith("validation-")
    return free_recording_name(f"data-{name}" if is_reserved else name)


def _write(
    data: ImportedData, name: str, out: Path | None, files: Sequence[Path]
) -> tuple[str, Path]:
    """Write a new file, by default in the folder of the recordings; return the run's id, and it."""
    from armrig.data.files.imported_file import write_imported
    from armrig.data.files.loading import MOST_BYTES
    from armrig.recordings.files.recording_names import recording_folder

    now = datetime.now(UTC).astimezone()
    started = now.isoformat(timespec="milliseconds")
    run_id, content = write_imported(data, name=name, started=started, armrig=version("armrig"))
    if len(content) > MOST_BYTES:
        raise InputError(
            f"the recording would have {len(content) >> 20} MiB, and at most {MOST_BYTES >> 20} "
            "MiB can be read: name the columns that you need (--input, --signal), or cut the file"
        )
    if out is None:
        out = recording_folder() / f"{IMPORTED}-{name}-{now.strftime(_STAMP)}-{run_id}.mcap"
    else:
        check_output(out, files, "-o", "a recording", ".mcap")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with out.open("xb") as file, whole_file(out):  # a file that exists stays
            file.write(content)
    except PermissionError as err:
        raise InputError(
            f"{out.parent}: this user may not write there; give a file of your own, -o data.mcap"
        ) from err
    return run_id, out


def import_facts(data: ImportedData) -> dict[str, object]:
    """Return the facts of imported data as a dict for JSON."""
    return {
        "import": data.facts,
        "Ts": data.Ts,
        "samples": len(data.at),
        "missing": data.size - len(data.at),
    }


def import_rows(
    data: ImportedData, called: str, path: Path, *, verbose: bool
) -> Iterator[tuple[str, str]]:
    """Yield the rows of a table of imported data, with the verdict as the first row."""
    import numpy as np

    facts, rows = data.facts, len(data.at)
    doubts = [text for text, code in facts.history if code == DOUBT]
    doubts += [finding.text for finding in few_samples(rows, called)]
    yield (
        "verdict",
        "; ".join(["doubtful: " + doubts[0], *doubts[1:]] if doubts else ["read without a doubt"]),
    )
    yield "recording", f"{called}: {path}" if called != str(path) else called
    yield "from", ", ".join(source.name for source in facts.sources)
    if facts.options:
        yield "options", ", ".join(f"{key} {value}" for key, value in facts.options.items())
    most = len(facts.columns) if verbose else _MAX_SHOWN
    listed = [f"{c.name} [{c.unit}]" if c.unit else c.name for c in facts.columns]
    yield "columns", some(listed, most)
    for role, columns in (("inputs", facts.inputs), ("outputs", facts.outputs)):
        if columns:
            yield role, ", ".join(columns)
    missing = f", {data.size - rows} missing" if data.size > rows else ""
    breaks = f", in {plural(len(facts.breaks) + 1, 'experiment')}" if facts.breaks else ""
    is_given = "Ts" in facts.options
    clock = f", by the times in {facts.clock}" if facts.clock and not is_given else ""
    yield "samples", f"{rows} at {data.Ts:g} s{missing}{breaks}{clock}"
    without = np.count_nonzero(np.isnan(data.values), axis=0)
    empty = [f"{c.name} in {n}" for c, n in zip(facts.columns, without, strict=True) if n]
    if empty:
        yield "no value", some(empty, most)
    for text, code in facts.history:
        if code != DOUBT:
            yield "read", text
    if verbose:
        for source in facts.sources:
            yield "sha256", f"{source.sha256} {source.name}"
