"""The commands on recordings: ls, info, verify, export, recover, replay."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import compress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from armrig_core.commands.codes import COMPLETE
from armrig_core.errors import InputError
from armrig_core.process.options import argument, preset
from armrig_core.process.printable import printable

import armrig
from armrig.cli.next_step import OF_KIND, command_line_name, say_next
from armrig.cli.options import CalibrationFile, From, Json, To
from armrig.cli.printing import (
    columns,
    echo,
    fields_of,
    inform,
    print_json,
    print_result,
    print_table,
    report_damage,
    some,
    spinner,
    tell,
)
from armrig.cli.recorded_data import File, Part, name_recording
from armrig.cli.results import (
    Draw,
    Plot,
    Shown,
    check_output,
    check_plot,
    name_runs,
    whole_file,
    write_plot,
)
from armrig.numerics.quantities import plural

if TYPE_CHECKING:
    from armrig_core.recording_file.recovery import RecoveredFile

    from armrig.recordings.files.catalogue import Catalogue, LeftOut
    from armrig.recordings.files.recording_names import Answering
    from armrig.recordings.files.recording_summary import RecordingSummary

Folder = Annotated[
    Path | None,
    argument("FOLDER", "Folder of the recordings.", "the folder that the daemon records into"),
]
Naming = Callable[["RecordingSummary"], str]
_DEFAULT_COUNT = 20
_MAX_NAMES = 3
_MAX_WIDTH = 60  # characters of a column
_HEADINGS = ("recording", "kind", "length", "Ts", "missing", "started", "outcome", "validates")
_OPTIONAL = 2  # number of optional columns, which are the last columns


def ls(
    where: Folder = None,
    count: int = preset(_DEFAULT_COUNT, "Number of the newest recordings to list.", min=1),
    every: bool = preset(False, "List all recordings.", names="--all"),
    live: bool = preset(False, "List the rigs that are alive."),
    connect: str | None = preset(
        None,
        "zenoh endpoint of a router or daemon; only with --live.",
        "the configuration's [client] connect, otherwise all rigs of this machine",
        metavar="ENDPOINT",
    ),
    json: Json = False,
) -> None:
    """List the recordings, newest first, or with --live the rigs.

    Other commands accept the listed names, and @last, in place of a file. If you give a FOLDER,
    the list contains file names instead. With --connect, --live lists the rigs at the given
    endpoint.
    """
    if live and (where is not None or every):
        raise InputError(
            "--live lists rigs: leave out the folder and --all, which are for recordings"
        )
    if connect and not live:
        raise InputError(f"--connect {connect} needs --live: without --live, ls lists files")
    if live:
        _list_rigs(connect, json=json)
        return
    from armrig.recordings.files.catalogue import Catalogue, facts_of
    from armrig.recordings.files.recording_names import (
        answering_among,
        recording_folder,
        short_name,
    )

    folder = where or recording_folder()
    try:
        catalogue = armrig.catalogue(folder)
    except (FileNotFoundError, NotADirectoryError):
        if where is not None:
            raise
        catalogue = Catalogue(folder=folder, recordings=(), left_out=(), unfinished=())
    summaries = catalogue.recordings if every else catalogue.recordings[:count]
    if json:
        left_out = [
            {"recording": path, "why": why, "foreign": is_foreign}
            for path, why, is_foreign in catalogue.left_out
        ]
        facts = {"folder": folder, "recordings": [facts_of(s) for s in summaries]}
        print_json(facts | {"left_out": left_out, "unfinished": catalogue.unfinished})
        return
    answering = answering_among(catalogue.recordings)

    def name_of(summary: RecordingSummary) -> str:
        # A name such as @last means a recording in the default folder.
        return str(summary.path) if where else short_name(summary, answering)

    if summaries:
        rows = [_row(s, name_of, answering) for s in summaries]
        # An optional column is left out if it is empty, or if all its outcomes are complete.
        kept = [True] * (len(_HEADINGS) - _OPTIONAL)
        kept += [not {row[i] for row in rows} <= {"", COMPLETE.text} for i in range(-_OPTIONAL, 0)]
        # A name is never cut, because a person types it; it does not widen the other rows.
        echo(columns([tuple(compress(row, kept)) for row in (_HEADINGS, *rows)], _MAX_WIDTH))
    inform(_the_rest(catalogue, len(summaries)), dim=True)
    if summaries:
        newest = summaries[0]
        say_next(
            "info", file=command_line_name(newest.path) if where else short_name(newest, answering)
        )


def _list_rigs(connect: str | None, *, json: bool) -> None:
    from armrig.rig.status import live_rigs

    where, replies = live_rigs(connect)
    if json:
        rigs = [fields_of(r, "rig endpoint status why") for r in replies]
        print_json({"where": where, "rigs": rigs})
        return
    if not replies:
        tell(
            f"no rig is alive at {where}: start one with `armrig lab` or `armrigd run`; for a rig "
            "of another machine give its router, --connect tls/HOST:PORT"
        )
        return
    rows = [
        (r.rig, s.phase, f"{s.Ts:g} s", s.owner or "nobody", s.reason or s.line)
        if (s := r.status) is not None
        else (r.rig, "", "", "", r.why)
        for r in replies
    ]
    heading = ("rig", "phase", "Ts", "owner", "")
    echo(columns([heading, *(tuple(map(printable, r)) for r in rows)], _MAX_WIDTH))


def _row(summary: RecordingSummary, name_of: Naming, answering: Answering) -> tuple[str, ...]:
    why = re.split("[:(]", summary.outcome)[0].strip()
    cells = (
        name_of(summary),
        _short(summary.kind),
        f"{summary.seconds:g} s",
        f"{summary.Ts:g} s",
        str(summary.missing),
        summary.started[:16].replace("T", " "),
        _short(why),
        _estimation_name(summary, name_of, answering),
    )
    return tuple(map(printable, cells))  # a name may have a line break in it


def _short(text: str) -> str:
    return text if len(text) <= _MAX_WIDTH else f"{text[: _MAX_WIDTH - 1]}…"


def _estimation_name(summary: RecordingSummary, name_of: Naming, answering: Answering) -> str:
    """Return the estimation recording's name; "" if the validation recording's name contains it."""
    from armrig.recordings.files.recording_names import VALIDATION, short_name

    if not summary.is_validation or short_name(summary, answering).endswith(VALIDATION):
        return ""
    estimations = answering(f"@{summary.validation_of}") if summary.validation_of else []
    return name_of(estimations[0]) if estimations else "not known"


def _the_rest(catalogue: Catalogue, count: int) -> str:
    """Return a line about the files that are not in the table."""
    if not (catalogue.recordings or catalogue.left_out or catalogue.unfinished):
        return f"there are no recordings in {catalogue.folder}; make one with `armrig collect`"
    parts = [f"in {catalogue.folder}"]
    if older := len(catalogue) - count:
        parts.append(f"{plural(older, 'older recording')}: --all")
    if damaged := [left for left in catalogue.left_out if not left.is_foreign]:
        parts.append(f"damaged: {_names(damaged)}; `armrig info FILE` shows the damage")
    if foreign := [left for left in catalogue.left_out if left.is_foreign]:
        parts.append(f"not made by armrig: {_names(foreign)}; `armrig hints FILE` lists the topics")
    if unfinished := len(catalogue.unfinished):
        parts.append(f"{unfinished} being written, or left by a dead daemon: `armrig recover`")
    return "; ".join(parts)


def _names(left_out: Sequence[LeftOut]) -> str:

    from armrig.recordings.files.recording_summary import path_text

    return some([path_text(Path(left.path.name)) for left in left_out], _MAX_NAMES)


TIMING_HEIGHT = 2.8  # of a figure, in inches


def info(file: File, part: Part, out: Shown) -> None:
    """Show what a recording contains and how well it was sampled."""
    from armrig.recordings.files.control_run import control_run, own_control_run
    from armrig.recordings.files.imports import load_import
    from armrig.recordings.overview import contents_facts, contents_rows

    if (data := load_import(file)) is not None:
        from armrig.cli.imports import import_facts, import_rows

        out.show(
            facts=lambda: import_facts(data),
            say=lambda: print_table(
                *import_rows(data, command_line_name(file), file, verbose=out.verbose), verdict=True
            ),
            say_next=lambda: say_next("plot", file=command_line_name(file)),
        )
        return
    recording = name_recording(
        armrig.load(file, part.calibration, start=part.start, stop=part.stop)
    )
    name_runs(recording)
    run = control_run(recording) or own_control_run(recording)

    def say_next_command() -> None:
        if recording.N:
            say_next("plot", file=command_line_name(file))

    out.show(
        facts=lambda: contents_facts(recording) | ({"control": run.facts()} if run else {}),
        say=lambda: print_table(
            *contents_rows(recording, verbose=out.verbose),
            *([("control", run.summary)] if run else []),
            verdict=True,
        ),
        figures=lambda: timing_figures(recording),
        say_next=say_next_command,
        height=TIMING_HEIGHT,
    )


def timing_figures(recording: armrig.Recording) -> dict[str, Draw]:
    """Return the functions that draw the jitter and the lateness of a recording, if they vary."""
    from armrig.recordings.figures import plot_timing, varying_times

    varying = varying_times(recording)
    return {name: partial(plot_timing, recording, quantity=name) for name in varying}


def replay(file: File, json: Json = False) -> None:
    """Repeat the decisions of the daemon's core for a recorded run.

    The exit code is 1 if a decision differs from the recording.
    """
    from armrig.recordings.files.imports import require_rig
    from armrig.recordings.files.replay import replay as decided_again

    require_rig(file, "replay")
    rerun = decided_again(file)
    if json:
        print_json(rerun)
    else:
        same = "replay made the same decisions, to the last bit"
        same += f", up to the end of the file: {rerun.until}" if rerun.until else ""
        print_table(
            ("replayed", f"{plural(rerun.steps, 'step')} of the core over {rerun.seconds:.3f} s"),
            ("frames", f"{rerun.frames} to the device, as recorded"),
            ("samples", f"{rerun.samples} as recorded"),
            *((s.level, f"{s.t:.3f} s: {s.message}") for s in rerun.said),
            ("verdict", f"DIFFERS: {rerun.difference}" if rerun.difference else same),
        )
    if rerun.difference:
        raise typer.Exit(1)


Where = Annotated[
    list[Path] | None,
    argument(
        "FILE|FOLDER…",
        "Unfinished recordings (*.mcap.active), or folders that contain them.",
        "the folder that the daemon records into",
    ),
]


def plot(
    file: File,
    part: Part,
    figure: Plot = Path("plot.png"),
    json: Json = False,
) -> None:
    """Plot a recording, and report its faults (handout 3.1.4).

    The figure shows u, the channels and their rates. Missing samples and the dead band are shaded,
    and outliers are ringed. A drift is reported in the text.
    """
    from armrig.recordings.files.imports import load_import
    from armrig.recordings.overview import overview

    check_plot(figure, [file])
    if (data := load_import(file)) is not None:
        from armrig.data.figures import plot_columns

        [written] = write_plot(figure, signals=partial(plot_columns, data), height=7.0)
        if json:
            print_json({"figure": written, "samples": len(data.at)})
        else:
            say_next("info", file=command_line_name(file))
        return
    [recording] = part.recordings(file)
    with spinner("looking for outliers and drift"):
        summary = overview(recording)
    [written] = write_plot(figure, signals=summary.plot, height=7.0)
    if json:
        print_json(summary.facts() | {"figure": written})
        return
    print_table(*summary.rows())
    say_next(OF_KIND.get(recording.manifest.kind, "hints"), file=command_line_name(file))


def verify(file: File, json: Json = False) -> None:
    """Check the integrity of a recording.

    The checks cover samples and gap records, voltages, input, times, hashes and clocks. The exit
    code is 1 if a check fails; the readable data can still be loaded and exported.
    """
    from armrig.recordings.files.verification import RESULTS, rows
    from armrig.recordings.files.verification import verify as verified
    from armrig.recordings.findings import TOO_FEW

    with spinner("checking"):
        verification = verified(file)
    if json:
        checks = [
            {"about": c.about, "result": RESULTS[c.level], "text": c.text}
            for c in verification.checks
        ]
        facts = {"recording": str(verification.path), "sha256": verification.sha256}
        print_json(facts | {"passed": verification.passed, "checks": checks})
    else:
        print_table(*rows(verification), verdict=True)
    if not verification.passed:
        failed = ", ".join(c.about for c in verification.checks if c.level == "unusable")
        n = verification.samples
        use = (
            f"its {plural(n, 'sample')} can be used, with care" if n else "it has no usable sample"
        )
        if 0 < n < TOO_FEW:
            use = f"{plural(n, 'sample is', 'samples are')} left, at least {TOO_FEW} are needed"
        tell(f"{verification.path}: failed: {failed}; {use}")
        raise typer.Exit(1)


def export(
    file: File,
    out: Annotated[Path, argument("OUT", "File to write.")],
    transforms: bool = preset(
        False, "Write an MCAP file with the poses of the arm for Foxglove's 3D panel."
    ),
    raw: bool = preset(False, "Include the readings and times as recorded."),
    signal: str | None = preset(
        None, "Signal that becomes y in the MAT-file.", "the first channel", metavar="NAME"
    ),
    start: From = None,
    stop: To = None,
    calibration: CalibrationFile = None,
    json: Json = False,
) -> None:
    """Write the data of a recording for another program.

    The suffix of OUT chooses the format: .csv for any program, .mat for MATLAB and Octave (u, y, Ts
    and all columns), .parquet for pandas, polars and others.

    In MATLAB: `s = load('data.mat'); z = iddata(s.y, s.u, s.Ts)`. Missing samples have rows, too.
    A missing y is NaN.
    """
    from armrig.physics.files.poses import write_transforms
    from armrig.recordings.files.export import (
        write_csv,
        write_imported_columns,
        write_mat,
        write_parquet,
    )
    from armrig.recordings.files.imports import load_import

    writers: dict[str, Callable[..., Any]] = {
        ".csv": partial(write_csv, raw=raw),
        ".mat": partial(write_mat, output=signal, raw=raw),
        ".parquet": partial(write_parquet, raw=raw),
    }
    write = write_transforms if transforms else writers.get(out.suffix.lower())
    if write is None:
        raise typer.BadParameter(
            f"{out}: give a name that ends in .csv, .mat or .parquet, or --transforms"
        )
    check_output(out, [file])
    if (data := load_import(file)) is not None:
        if transforms or raw or signal or calibration or (start, stop) != (None, None):
            raise InputError("imported data are exported whole: leave the options out")
        with spinner("writing"), whole_file(out):
            write_imported_columns(data, out)
        rows, missing = len(data.at), data.size - len(data.at)
        print_result(
            {"file": out, "samples": data.size, "recording": data.sha256},
            f"{out}: {plural(rows + missing, 'sample')}, {missing} of them missing",
            json=json,
        )
        return
    with spinner("reading"):
        recording = name_recording(armrig.load(file, calibration, start=start, stop=stop))
    if signal is not None and signal not in recording.channels:
        has = ", ".join(recording.channels)
        raise typer.BadParameter(f"--signal {signal}: the recording has {has}")
    report_damage(recording)
    with spinner("writing"), whole_file(out):
        write(recording, out)
    facts = {"file": out, "samples": recording.N, "recording": recording.sha256}
    text = f"{out}: {plural(recording.N, 'sample')}, {recording.missing} of them missing"
    print_result(facts, text, json=json)


def recover(where: Where = None, json: Json = False) -> None:
    """Finish recordings that a daemon left unfinished when it died.

    A daemon completes its own recordings when it starts again; this command is for copied files. It
    refuses a file that a daemon is still writing. Each file keeps its undamaged part and gets a
    name that ends in .mcap. If a file cannot be recovered, it stays unchanged, and the exit code is
    1.
    """
    from datetime import UTC, datetime
    from importlib.metadata import version

    from armrig_core.recording_file.recovery import Recovery, sentence
    from armrig_core.recording_file.unfinished import NotOursError, RecoveryError

    from armrig.recordings.files.recording_names import recording_folder

    paths = list(_files(where or [recording_folder()]))
    done: list[RecoveredFile] = []
    left: list[tuple[Path, str]] = []
    failed = False
    recovery = Recovery(
        armrig=version("armrig"),
        now=lambda: datetime.now(UTC).astimezone().isoformat(timespec="milliseconds"),
    )
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
        outcome = "samples missing outcome"
        recovered = [
            {
                "recording": file.path,
                **fields_of(file.outcome, outcome),
                "recovered": file.recovered,
            }
            for file in done
        ]
        unfinished = [{"recording": path, "why": why} for path, why in left]
        print_json({"recovered": recovered, "left": unfinished})
    elif not paths:
        inform(f"nothing to recover in {', '.join(map(str, where or [recording_folder()]))}")
    if failed:
        raise typer.Exit(1)


def _files(where: list[Path]) -> Iterator[tuple[Path, bool]]:
    """Yield each unfinished file, and True if the user named the file and not its folder."""
    from armrig_core.recording_file.unfinished import unfinished_files

    for path in where:
        if path.is_dir():
            yield from ((file, False) for file in unfinished_files(path))
        else:
            yield path, True
