"""The commands about files: info of a recording, report of several."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armrig.cli.options import (
    SAME_DATA,
    CalibrationFile,
    File,
    Json,
    Na,
    Nb,
    Nf,
    Nk,
    echo,
    print_json,
    print_table,
    tell,
    warned,
)

if TYPE_CHECKING:
    from armrig.recordings.recording import Recording

_MCAP = b"\x89MCAP0\r\n"


def info(
    file: File,
    calibration: CalibrationFile = None,
    json: Json = False,
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="PNG", help="Figure of the timing to write.")
    ] = None,
) -> None:
    """Say what a recording holds and how well it was sampled."""
    from armrig.recordings.calibration.staleness import calibrated, remarks
    from armrig.recordings.gap_summary import gap_lines
    from armrig.recordings.jitter import sampling_statistics
    from armrig.recordings.loading import load
    from armrig.recordings.timing_disturbances import disturbance_rows, disturbances
    from armrig.recordings.usability import data_verdict

    if plot is not None:
        check_output(plot, [file])
    rec = load(file, calibration)
    if plot is not None:
        _plot_timing(rec, plot)
    timing = sampling_statistics(rec)
    if json:
        facts = {"sha256": rec.sha256, "manifest": rec.manifest, "outcome": rec.outcome}
        facts |= {"samples": int(rec.samples.size), "missing": rec.missing, "invalid": rec.hidden}
        facts |= {"truncated": rec.truncated, "damage": rec.damage, "sampling": timing}
        facts |= {"causes": disturbances(rec), "calibration": rec.calibration}
        facts |= {"remarks": remarks(rec.calibration, rec.manifest)}
        facts |= {"verdict": data_verdict(rec).facts()}
        print_json(facts | {"gaps": rec.gaps, "events": rec.events})
        return
    manifest = rec.manifest
    jitter, lateness = timing.jitter, timing.lateness
    details = ", ".join(f"{k} {v}" for k, v in manifest.details.items())
    print_table(
        ("recording", str(rec.path)),
        ("sha256", rec.sha256),
        ("run", f"{manifest.run_id} of rig {manifest.rig}, {manifest.started}"),
        ("experiment", f"{manifest.experiment}: {details}" if details else manifest.experiment),
        (
            "samples",
            f"{rec.samples.size} at {rec.Ts:g} s, {rec.missing} missing, {rec.hidden} without "
            "an angle (dead band, and the sample after)"
            + f"; up to {rec.N * rec.Ts:g} s of {rec.asked_s:g} s"
            * rec.truncated,
        ),
        ("paced by", "the device" if manifest.pacing == "scheduled" else "the host"),
        ("outcome", _outcome(rec)),
        ("calibrated", calibrated(rec.calibration)),
        *(("remark", text) for text in remarks(rec.calibration, rec.manifest)),
        ("jitter", _microseconds(jitter, 0)),
        ("lateness", _lateness(lateness, manifest.pacing)),
        *disturbance_rows(disturbances(rec)),
        *(("gap", text) for text in gap_lines(rec.gaps)),
        *(("damage", rec.damage) for _ in range(rec.truncated)),
        ("verdict", data_verdict(rec).in_a_line),
    )


def replay(file: File, json: Json = False) -> None:
    """Have the daemon's core decide a recorded run once more.

    Exit code 1 where it differs.
    """
    from armrig.cli.replay import replay as decided_again

    found = decided_again(file)
    if json:
        print_json(found)
    else:
        same = found.difference or "decided the same, to the last bit"
        if found.until and not found.difference:
            same += f", as far as both go: {found.until}"
        print_table(
            ("replayed", f"{found.steps} steps of the core over {found.seconds:.3f} s"),
            ("frames", f"{found.frames} to the device, as recorded"),
            ("samples", f"{found.samples} as recorded"),
            *((s.level, f"{s.t:.3f} s: {s.message}") for s in found.said),
            ("verdict", f"DIFFERS: {same}" if found.difference else same),
        )
    if found.difference:
        raise typer.Exit(1)


def report(
    files: Annotated[list[Path], typer.Argument(metavar="F…", help="Recordings (*.mcap).")],
    output: Annotated[Path, typer.Option("-o", "--output", help="PDF to write.")] = Path(
        "report.pdf"
    ),
    na: Na = 4,
    nb: Nb = 4,
    nf: Nf = 4,
    nk: Nk = 1,
    calibration: CalibrationFile = None,
    json: Json = False,
) -> None:
    """Typeset a report.

    The first recording that is no step estimates, the next validates.
    """
    check_output(output, files, suffix=".pdf")
    from armrig.cli.waiting import estimating, waiting
    from armrig.recordings.loading import load
    from armrig.report.document import report as typeset
    from armrig.report.study import Orders, study

    recordings = [warned(load(f, calibration)) for f in files]
    with estimating("na, nb and nf"):
        done = study(recordings, orders=Orders(na=na, nb=nb, nf=nf, nk=nk))
    same = done.validation.digest == done.estimation.digest
    if same:
        tell(SAME_DATA)
    with waiting("typesetting"):
        typeset(done, output, remarks=[f"{SAME_DATA[0].upper()}{SAME_DATA[1:]}."] * same)
    if json:
        print_json({"report": str(output), "recordings": [r.sha256 for r in recordings]})
    else:
        echo(str(output))


def check_output(path: Path, inputs: Sequence[Path], suffix: str = "") -> None:
    """Refuse, before any work, what cannot or must not be written: a recording is never lost."""
    name = f"-o {path}" if suffix else str(path)
    if path.is_dir():
        example = path / ("report.pdf" if suffix else "timing.png")
        msg = f"{name}: is a directory; give a file, such as {example}"
        raise ValueError(msg)
    if path.exists() and any(f.exists() and path.samefile(f) for f in inputs):
        msg = f"{name}: is one of the recordings to read, which would be lost; give another name"
        raise ValueError(msg)
    if path.is_file():
        with path.open("rb") as file:
            if file.read(len(_MCAP)) == _MCAP:
                msg = f"{name}: is a recording, which would be lost; give another name"
                raise ValueError(msg)
    if suffix and path.suffix.lower() != suffix:
        msg = f"{name}: a report is a PDF; give a name that ends in {suffix}"
        raise ValueError(msg)
    if not path.absolute().parent.is_dir():
        msg = f"{name}: there is no directory {path.parent}; make it first"
        raise ValueError(msg)


def _outcome(rec: Recording) -> str:
    """Return how the run ended, and whether the file ended before it."""
    if not rec.truncated:
        return rec.outcome.outcome if rec.outcome else "not known: the file does not say"
    what = "is cut off" if rec.cut_off else "is damaged"
    writing = ", or is still being written" if rec.path.suffix == ".active" else ""
    if rec.outcome:
        return f"of the run: {rec.outcome.outcome}; but the file {what}"
    return f"not known: the file {what} before it says{writing}"


def _microseconds(spread: Any, decimals: int) -> str:
    if spread.n == 0:
        return "too few samples"
    parts = (("p50", spread.p50, decimals), ("p99", spread.p99, decimals), ("max", spread.max, 0))
    return ", ".join(f"{name} {value:.{places}f}" for name, value, places in parts) + " µs"


def _lateness(spread: Any, pacing: str) -> str:
    of = "the host's request for each sample"
    if pacing == "scheduled":
        of = "the samples' arrival at the host, which changes nothing in them"
    return _microseconds(spread, 1) + (f"; of {of}" if spread.n else "")


def _plot_timing(recording: Any, path: Path) -> None:
    from matplotlib.figure import Figure

    from armrig.plots import plot_timing

    figure = Figure(figsize=(9.0, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    plot_timing(recording, quantity="jitter", ax=left)
    plot_timing(recording, quantity="lateness", ax=right)
    figure.savefig(path, dpi=150)
