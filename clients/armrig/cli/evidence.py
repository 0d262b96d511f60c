"""The commands on the files of recordings: verify, export, recover."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from armrig_core.telemetry.telemetry import THETA_1, ChannelName

from armrig.cli.options import CalibrationFile, From, Json, To, argument, chosen, option
from armrig.cli.printing import echo, fields_of, inform, print_json, print_table, tell, warned
from armrig.cli.reading_options import File
from armrig.cli.spinner import spinner

if TYPE_CHECKING:
    from armrig_core.recording_file.recovery import RecoveredFile

Out = Annotated[Path, argument("OUT", "File to write.")]
Parquet = Annotated[bool, option("--parquet", "Write Parquet, for pandas, polars and others.")]

Where = Annotated[
    list[Path] | None,
    argument(
        "FILE|FOLDER…",
        "Unfinished recordings (*.mcap.active), or folders that contain them.",
        "the folder that the daemon records into",
    ),
]


def verify(file: File, json: Json = False) -> None:
    """Check the integrity of a recording.

    The checks cover samples and gap records, voltages, input, times, hashes and clocks. The exit
    code is 1 if a check fails; the readable data can still be loaded and exported.
    """
    from armrig.recordings.findings import TOO_FEW
    from armrig.recordings.verification import rows
    from armrig.recordings.verification import verify as verified

    with spinner("checking"):
        found = verified(file)
    if json:
        checks = [fields_of(c, "about result text") for c in found.checks]
        facts = {"recording": str(found.path), "sha256": found.sha256}
        print_json(facts | {"passed": found.passed, "checks": checks})
    else:
        print_table(*rows(found), verdict=True)
    if not found.passed:
        failed = ", ".join(c.about for c in found.checks if c.result == "failed")
        n = found.samples
        use = f"its {n} samples can be used, with care" if n else "it has no usable sample"
        if 0 < n < TOO_FEW:
            use = f"{n} samples are left, at least {TOO_FEW} are needed"
        tell(f"{found.path}: failed: {failed}; {use}")
        raise typer.Exit(1)


def export(
    file: File,
    out: Out,
    csv: bool = chosen(False, "--csv", "Write CSV, for any program."),
    mat: bool = chosen(
        False, "--mat", "Write a MAT-file for MATLAB and Octave: u, y, Ts and all columns."
    ),
    parquet: Parquet = False,
    transforms: bool = chosen(
        False,
        "--transforms",
        "Write an MCAP file with the poses of chassis and arm for Foxglove's 3D panel.",
    ),
    raw: bool = chosen(False, "--raw", "Include the readings and times as recorded."),
    signal: ChannelName = chosen(THETA_1, "--signal", "Signal that becomes y in the MAT-file."),
    start: From = None,
    stop: To = None,
    calibration: CalibrationFile = None,
    json: Json = False,
) -> None:
    """Write the data of a recording for another program.

    The suffix of OUT (.csv, .mat, .parquet) or an option chooses the format.

    In MATLAB: `s = load('data.mat'); z = iddata(s.y, s.u, s.Ts)`. Missing samples have rows, too.
    A missing y is NaN.
    """
    from armrig.cli.results import check_output
    from armrig.recordings.export import write_csv, write_mat, write_parquet, write_transforms
    from armrig.recordings.loading import load

    asked = {"csv": csv, "mat": mat, "parquet": parquet, "transforms": transforms}
    kind = _kind(out, asked)
    writers: dict[str, Callable[..., Any]] = {
        "csv": partial(write_csv, raw=raw),
        "mat": partial(write_mat, output=signal, raw=raw),
        "parquet": partial(write_parquet, raw=raw),
        "transforms": write_transforms,
    }
    check_output(out, [file])
    with spinner("reading"):
        recording = load(file, calibration, start=start, stop=stop)
    warned(recording)
    with spinner("writing"), _whole(out):
        writers[kind](recording, out)
    if json:
        print_json({"file": str(out), "samples": recording.N, "recording": recording.sha256})
    else:
        echo(f"{out}: {recording.N} samples, {recording.missing} of them missing")


@contextmanager
def _whole(out: Path) -> Iterator[None]:
    """Delete the output file if an error interrupts its writing."""
    try:
        yield
    except BaseException as err:
        if out.is_file():
            with suppress(OSError):
                out.unlink()
        if isinstance(err, OSError) and not err.filename:  # the error of a write names no file
            raise OSError(err.errno, err.strerror or str(err), str(out)) from err
        raise


def _kind(out: Path, asked: dict[str, bool]) -> str:
    kinds = [kind for kind, wanted in asked.items() if wanted]
    if len(kinds) > 1:
        raise typer.BadParameter(f"--{kinds[0]} and --{kinds[1]}: a file has one format")
    ending = out.suffix.lower().removeprefix(".")
    if kinds or ending in asked:
        return kinds[0] if kinds else ending
    raise typer.BadParameter(
        f"{out}: give --csv, --mat, --parquet or --transforms, or a name that ends in "
        ".csv, .mat or .parquet"
    )


def recover(where: Where = None, json: Json = False) -> None:
    """Finish recordings that a daemon left unfinished when it died.

    A daemon completes its own recordings when it starts again; this command is for copied files. It
    refuses a file that a daemon is still writing. Each file keeps its undamaged part and gets a
    name that ends in .mcap. If a file cannot be recovered, it stays unchanged, and the exit code is
    1.
    """
    from armrig_core.recording_file.recovery import sentence
    from armrig_core.recording_file.unfinished import NotOursError, RecoveryError

    from armrig.recordings.recording_names import recording_folder

    paths = list(_files(where or [recording_folder()]))
    done: list[RecoveredFile] = []
    left: list[tuple[Path, str]] = []
    failed = False
    recovery = _recovery()
    for path, is_named in paths:
        try:
            done.append(recovery.recover(path))
        except RecoveryError as err:
            left.append((path, str(err)))
            failed |= is_named or not isinstance(err, NotOursError)
            tell(str(err))
        else:
            if not json:
                echo(sentence(done[-1]))
    if json:
        unfinished = [{"recording": str(path), "why": why} for path, why in left]
        print_json({"recovered": [_facts(file) for file in done], "left": unfinished})
    elif not paths:
        inform(f"nothing to recover in {', '.join(map(str, where or [recording_folder()]))}")
    if failed:
        raise typer.Exit(1)


def _files(where: list[Path]) -> Iterator[tuple[Path, bool]]:
    """Yield each unfinished file, and True if the user named the file and not its folder."""
    from armrig_core.recording_file.unfinished import unfinished

    for path in where:
        if path.is_dir():
            yield from ((file, False) for file in unfinished(path))
        else:
            yield path, True


def _recovery() -> Any:
    from datetime import UTC, datetime
    from importlib.metadata import version

    from armrig_core.recording_file.recovery import Recovery

    return Recovery(
        armrig=version("armrig"),
        now=lambda: datetime.now(UTC).astimezone().isoformat(timespec="milliseconds"),
    )


def _facts(file: RecoveredFile) -> dict[str, Any]:
    outcome = fields_of(file.outcome, "samples missing outcome")
    return {"recording": str(file.path)} | outcome | {"recovered": file.recovered}
