"""The commands about one recording: info and replay."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from armrig.cli.figures import Plot, check_plot, name_runs, write_plot
from armrig.cli.next_step import say_next, typed
from armrig.cli.options import (
    CalibrationFile,
    From,
    Json,
    To,
    Verbose,
    print_json,
    print_table,
)
from armrig.cli.reading_options import File

if TYPE_CHECKING:
    from armrig_core.manifest import Recovered

    from armrig.cli.replay import Replay
    from armrig.recordings.recording import Recording

_MAX_GAPS, _MAX_NOTES = 3, 10  # lines without --verbose
_MAX_TEXT = 1000  # characters


def info(
    file: File,
    calibration: CalibrationFile = None,
    start: From = None,
    stop: To = None,
    json: Json = False,
    verbose: Verbose = False,
    plot: Plot = None,
) -> None:
    """Show what a recording contains and how well it was sampled."""
    from armrig.recordings.loading import load

    check_plot(plot, [file])
    recording = load(file, calibration, start=start, stop=stop)
    name_runs(recording)
    _plot_timing(recording, plot)
    if json:
        print_json(_recording_facts(recording))
    else:
        print_table(*_recording_rows(recording, verbose=verbose), verdict=True)
        if recording.N:
            say_next("info", file=typed(file))


def _recording_facts(rec: Recording) -> dict[str, Any]:
    """Return the contents of a recording as JSON fields."""
    from armrig.recordings.jitter import disturbances, sampling_statistics
    from armrig.recordings.usability import data_verdict, doubts_of_calibration

    return {
        "sha256": rec.sha256,
        "manifest": rec.manifest,
        "emulated": rec.manifest.emulated,
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
        "remarks": doubts_of_calibration(rec.calibration, rec.manifest),
        "verdict": data_verdict(rec).facts(),
        "gaps": rec.gaps,
        "events": rec.events,
        "notes": rec.notes,
    }


def _recording_rows(rec: Recording, *, verbose: bool) -> Iterator[tuple[str, str]]:
    """Yield the rows of `armrig info`: the name of a quantity and its value as text."""
    from armrig.recordings.daemon_reports import gap_lines
    from armrig.recordings.jitter import disturbances, sampling_statistics
    from armrig.recordings.usability import calibration_date, data_verdict, doubts_of_calibration

    manifest, timing = rec.manifest, sampling_statistics(rec)
    details = ", ".join(f"{k} {v}" for k, v in manifest.details.items())
    verdict = data_verdict(rec)
    yield "verdict", verdict.summary
    yield "recording", str(rec.path)
    if verbose:
        yield "sha256", rec.sha256
    rig = f"rig {manifest.rig}{', emulated' if manifest.emulated else ''}"
    yield "run", f"{manifest.run_id} of {rig}, {manifest.started}"
    if manifest.owner:
        yield "owner", _clipped(manifest.owner)
    yield (
        "experiment",
        _clipped(f"{manifest.experiment}: {details}" if details else manifest.experiment),
    )
    yield "samples", _sample_count(rec)
    yield "outcome", _outcome(rec)
    if rec.recovered is not None:
        yield "recovered", _recovered(rec.recovered)
    yield "calibrated", calibration_date(rec.calibration)
    for text in doubts_of_calibration(rec.calibration, manifest):
        yield "remark", text
    yield "jitter", _jitter(timing.jitter)
    if verbose:
        yield "paced by", "the device" if manifest.pacing == "scheduled" else "the host"
        yield "host's lateness", _lateness(timing.lateness, manifest.pacing)
    if verbose and (found := disturbances(rec).texts()):
        yield "disturbances", "; ".join(f"{name}: {text}" for name, text in found.items())
    gaps = gap_lines(rec.gaps)
    for text in gaps if verbose else gaps[:_MAX_GAPS]:
        yield "gap", text
    if len(gaps) > _MAX_GAPS and not verbose:
        yield "gap", f"{len(gaps) - _MAX_GAPS} more lines; --verbose shows them"
    for note in rec.notes if verbose else rec.notes[:_MAX_NOTES]:
        yield "note", _clipped(f"at {note.t:.2f} s, {note.owner}: {note.text}")
    if len(rec.notes) > _MAX_NOTES and not verbose:
        yield "note", f"{len(rec.notes) - _MAX_NOTES} more; --verbose shows them"
    if rec.truncated:
        yield "damage", rec.damage
    for finding in verdict.findings if verbose else ():
        yield finding.about, finding.text


def _clipped(text: str) -> str:
    """Return a text, cut to `_MAX_TEXT` characters if it is longer."""
    return text if len(text) <= _MAX_TEXT else f"{text[:_MAX_TEXT]}…; --json shows all of it"


def _sample_count(rec: Recording) -> str:
    """Return the numbers of samples as text; for a truncated file, also the time of its end."""
    text = (
        f"{rec.samples.size} at {rec.Ts:g} s, {rec.missing} missing, {rec.hidden} without "
        "an angle (dead band, and the sample after)"
    )
    if rec.truncated:
        text += f"; up to {rec.N * rec.Ts:g} s of {rec.asked_s:g} s"
    return text


def _recovered(how: Recovered) -> str:
    cut_off = f", the last {how.cut_off_bytes} B were cut off" if how.cut_off_bytes else ""
    cut_off += f"; {how.damage}" if how.damage else ""
    when = how.when[:19].replace("T", " ")
    return f"{when} by armrig {how.armrig}: {how.kept_bytes} B were kept{cut_off}"


def _outcome(rec: Recording) -> str:
    """Return the outcome of the run as text, with a remark if the file is cut off or damaged."""
    if not rec.truncated:
        return rec.outcome.outcome if rec.outcome else "not known: the file does not contain it"
    what = "is cut off" if rec.cut_off else "is damaged"
    writing = ", or is still being written" if rec.path.suffix == ".active" else ""
    if rec.outcome:
        return f"of the run: {rec.outcome.outcome}; but the file {what}"
    return f"not known: the file {what} before the outcome{writing}"


def _microseconds(spread: Any, decimals: int) -> str:
    if spread.n == 0:
        return "too few samples"
    p50, p99 = f"{spread.p50:.{decimals}f}", f"{spread.p99:.{decimals}f}"
    return f"p50 {p50}, p99 {p99}, max {spread.max:.0f} µs"


def _jitter(spread: Any) -> str:
    text = _microseconds(spread, 0)
    return (
        text if spread.n == 0 else f"{text}; spread of the sampling interval, by the device's clock"
    )


def _lateness(spread: Any, pacing: str) -> str:
    text = _microseconds(spread, 1)
    if spread.n == 0:
        return text
    if pacing == "scheduled":
        return f"{text}; arrival of the samples at the host, which does not affect them"
    return f"{text}; lateness of the host's request for each sample"


def _plot_timing(recording: Any, path: Path | None) -> None:
    if path is None:
        return
    from armrig.recordings.figures import plot_timing

    write_plot(
        path,
        jitter=lambda ax: plot_timing(recording, quantity="jitter", ax=ax),
        lateness=lambda ax: plot_timing(recording, quantity="lateness", ax=ax),
        height=2.8,
    )


def replay(file: File, json: Json = False) -> None:
    """Repeat the decisions of the daemon's core for a recorded run.

    The exit code is 1 if a decision differs from the recording.
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
    same = "replay made the same decisions, to the last bit"
    if found.until:
        return f"{same}, up to the end of the file: {found.until}"
    return same
