"""The commands about files: info of a recording, report of several."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armrig.cli.chosen_recording import File, recording_path
from armrig.cli.next_step import say_next, typed
from armrig.cli.options import (
    SAME_DATA,
    CalibrationFile,
    From,
    Json,
    Na,
    Nb,
    Nf,
    Nk,
    To,
    Verbose,
    echo,
    print_json,
    print_table,
    tell,
)

if TYPE_CHECKING:
    from armrig_core.manifest import Recovered

    from armrig.cli.replay import Replay
    from armrig.recordings.recording import Recording

_GAPS = 3  # lines of them without --verbose
_MCAP = b"\x89MCAP0\r\n"


def info(
    file: File,
    calibration: CalibrationFile = None,
    start: From = None,
    stop: To = None,
    json: Json = False,
    verbose: Verbose = False,
    plot: Annotated[
        Path | None, typer.Option("-o", "--plot", metavar="FIGURE", help="Figure of the timing.")
    ] = None,
) -> None:
    """Say what a recording holds and how well it was sampled."""
    from armrig.recordings.loading import load

    if plot is not None:
        check_output(plot, [file])
    recording = load(file, calibration, start=start, stop=stop)
    if plot is not None:
        _plot_timing(recording, plot)
    if json:
        print_json(_recording_facts(recording))
    else:
        print_table(*_recording_rows(recording, verbose=verbose))
        say_next("info", file=typed(file))


def _recording_facts(rec: Recording) -> dict[str, Any]:
    """Return what a recording holds, for a program."""
    from armrig.recordings.calibration.staleness import remarks
    from armrig.recordings.jitter import sampling_statistics
    from armrig.recordings.timing_disturbances import disturbances
    from armrig.recordings.usability import data_verdict

    return {
        "sha256": rec.sha256,
        "manifest": rec.manifest,
        "outcome": rec.outcome,
        "recovered": rec.recovered,
        "samples": int(rec.samples.size),
        "missing": rec.missing,
        "invalid": rec.hidden,
        "truncated": rec.truncated,
        "damage": rec.damage,
        "sampling": sampling_statistics(rec),
        "causes": disturbances(rec),
        "calibration": rec.calibration,
        "remarks": remarks(rec.calibration, rec.manifest),
        "verdict": data_verdict(rec).facts(),
        "gaps": rec.gaps,
        "events": rec.events,
    }


def _recording_rows(rec: Recording, *, verbose: bool) -> Iterator[tuple[str, str]]:
    """Give what a recording holds, for a person: names and values."""
    from armrig.recordings.calibration.staleness import calibrated, remarks
    from armrig.recordings.gap_summary import gap_lines
    from armrig.recordings.jitter import sampling_statistics
    from armrig.recordings.timing_disturbances import disturbances
    from armrig.recordings.usability import data_verdict

    manifest, timing = rec.manifest, sampling_statistics(rec)
    details = ", ".join(f"{k} {v}" for k, v in manifest.details.items())
    verdict = data_verdict(rec)
    yield "verdict", verdict.summary
    yield "recording", str(rec.path)
    if verbose:
        yield "sha256", rec.sha256
    yield "run", f"{manifest.run_id} of rig {manifest.rig}, {manifest.started}"
    yield "experiment", f"{manifest.experiment}: {details}" if details else manifest.experiment
    yield "samples", _sample_count(rec)
    yield "outcome", _outcome(rec)
    if rec.recovered is not None:
        yield "recovered", _recovered(rec.recovered)
    yield "calibrated", calibrated(rec.calibration)
    for text in remarks(rec.calibration, manifest):
        yield "remark", text
    yield "jitter", _microseconds(timing.jitter, 0)
    if verbose:
        yield "paced by", "the device" if manifest.pacing == "scheduled" else "the host"
        yield "lateness", _lateness(timing.lateness, manifest.pacing)
    if verbose and (found := disturbances(rec).texts()):
        yield "disturbances", "; ".join(f"{name}: {text}" for name, text in found.items())
    gaps = gap_lines(rec.gaps)
    for text in gaps if verbose else gaps[:_GAPS]:
        yield "gap", text
    if len(gaps) > _GAPS and not verbose:
        yield "gap", f"{len(gaps) - _GAPS} more lines; --verbose shows them"
    if rec.truncated:
        yield "damage", rec.damage
    for finding in verdict.findings if verbose else ():
        yield finding.about, finding.text


def _sample_count(rec: Recording) -> str:
    """Return how many samples there are, how many are missing, and up to when they go."""
    text = (
        f"{rec.samples.size} at {rec.Ts:g} s, {rec.missing} missing, {rec.hidden} without "
        "an angle (dead band, and the sample after)"
    )
    if rec.truncated:
        text += f"; up to {rec.N * rec.Ts:g} s of {rec.asked_s:g} s"
    return text


def replay(file: File, json: Json = False) -> None:
    """Have the daemon's core decide a recorded run once more.

    Exit code 1 where it differs.
    """
    from armrig.cli.replay import replay as decided_again

    found = decided_again(file)
    if json:
        print_json(found)
    else:
        print_table(
            ("replayed", f"{found.steps} steps of the core over {found.seconds:.3f} s"),
            ("frames", f"{found.frames} to the device, as recorded"),
            ("samples", f"{found.samples} as recorded"),
            *((s.level, f"{s.t:.3f} s: {s.message}") for s in found.said),
            ("verdict", _replay_verdict(found)),
        )
    if found.difference:
        raise typer.Exit(1)


def _replay_verdict(found: Replay) -> str:
    if found.difference:
        return f"DIFFERS: {found.difference}"
    if found.until:
        return f"decided the same, to the last bit, as far as both go: {found.until}"
    return "decided the same, to the last bit"


def report(
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="F…", parser=recording_path, help="Recordings (*.mcap), or their @names."
        ),
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="PDF to write.")] = Path(
        "report.pdf"
    ),
    na: Na = 4,
    nb: Nb = 4,
    nf: Nf = 4,
    nk: Nk = 1,
    calibration: CalibrationFile = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite a PDF that is there.")] = False,
    handout: Annotated[
        bool,
        typer.Option(
            "--handout", help="A section for each assignment, at most ten pages; F… as there are."
        ),
    ] = False,
    json: Json = False,
) -> None:
    """Typeset a report.

    The first recording that is no step estimates, the next validates. A report tells of whole runs:
    it takes no --from and --to.
    """
    files = files or []
    if not (files or handout):
        msg = "give recordings to report on, such as those of `armrig collect blackbox "
        msg += "--validation`; --handout needs none"
        raise typer.BadParameter(msg)
    check_output(output, files, suffix=".pdf")
    if output.exists() and not force:
        msg = f"-o {output}: is there already; --force overwrites it, or give another name"
        raise ValueError(msg)
    if handout:
        _report_handout(files, output, calibration, na=na, nb=nb, nf=nf, nk=nk, json=json)
        return
    from armrig.cli.recorded_data import loaded
    from armrig.cli.spinner import estimating, spinner
    from armrig.report.document import report as typeset
    from armrig.report.study import Orders, study

    recordings = loaded(files, calibration)
    _tell_of_ignored(recordings)
    with estimating("na, nb and nf"):
        done = study(recordings, orders=Orders(na=na, nb=nb, nf=nf, nk=nk))
    remarks = []
    if done.validation.digest == done.estimation.digest:
        tell(SAME_DATA)
        remarks.append(f"{SAME_DATA[0].upper()}{SAME_DATA[1:]}.")
    with spinner("typesetting"):
        typeset(done, output, remarks=remarks)
    if json:
        print_json({"report": str(output), "recordings": [r.sha256 for r in recordings]})
    else:
        echo(str(output))


def _tell_of_ignored(recordings: Sequence[Recording]) -> None:
    """Tell which recordings no model of the report is estimated from or judged by."""
    from armrig.recordings.doubts import NO_MODEL

    kinds = [r.manifest.experiment.partition("-")[0] for r in recordings]
    excited = [r for r, kind in zip(recordings, kinds, strict=True) if kind not in NO_MODEL]
    for r in excited[2:]:
        tell(
            f"{r.path.name} is listed in the report, and no model is estimated from it or judged "
            f"by it: {excited[0].path.name} estimates, {excited[1].path.name} validates"
        )


def _report_handout(
    files: Sequence[Path],
    output: Path,
    calibration: Path | None,
    *,
    na: int,
    nb: int,
    nf: int,
    nk: int,
    json: bool,
) -> None:
    """Typeset the handout's report from whatever there is."""
    from armrig.cli.recorded_data import loaded
    from armrig.cli.spinner import estimating, spinner
    from armrig.report.handout import handout_report
    from armrig.report.handout_study import handout_study
    from armrig.report.study import Orders
    from armrig.report.typesetting import ReportError

    recordings = loaded(files, calibration, one_plant=False)
    with estimating("na, nb and nf"):
        done = handout_study(recordings, orders=Orders(na=na, nb=nb, nf=nf, nk=nk))
    try:
        with spinner("typesetting"):
            path = handout_report(done, output)
    except ReportError as err:
        raise ValueError(str(err)) from err
    if json:
        print_json({"report": str(path), "recordings": [r.sha256 for r in recordings]})
    else:
        echo(str(path))


def check_output(path: Path, inputs: Sequence[Path], suffix: str = "") -> None:
    """Refuse, before any work, a file that cannot be written, or must not: a recording is kept."""
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


def _recovered(how: Recovered) -> str:
    cut_off = f", {how.cut_off_bytes} B behind them cut off" if how.cut_off_bytes else ""
    when = how.when[:19].replace("T", " ")
    return f"{when} by armrig {how.armrig}: {how.kept_bytes} B were whole{cut_off}"


def _outcome(rec: Recording) -> str:
    """Return how the run ended, and whether the file ends before that."""
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
    p50, p99 = f"{spread.p50:.{decimals}f}", f"{spread.p99:.{decimals}f}"
    return f"p50 {p50}, p99 {p99}, max {spread.max:.0f} µs"


def _lateness(spread: Any, pacing: str) -> str:
    text = _microseconds(spread, 1)
    if spread.n == 0:
        return text
    if pacing == "scheduled":
        return f"{text}; of the samples' arrival at the host, which changes nothing in them"
    return f"{text}; of the host's request for each sample"


def _plot_timing(recording: Any, path: Path) -> None:
    from matplotlib.figure import Figure

    from armrig.canvas import save
    from armrig.plots import plot_timing

    figure = Figure(figsize=(6.3, 2.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    plot_timing(recording, quantity="jitter", ax=left)
    plot_timing(recording, quantity="lateness", ax=right)
    save(figure, path, dpi=200)
