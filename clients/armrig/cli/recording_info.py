"""The commands about one recording: info and replay."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

import typer

from armrig.cli.next_step import say_next, typed
from armrig.cli.options import Json
from armrig.cli.printing import fields_of, print_json, print_table
from armrig.cli.reading_options import File
from armrig.cli.recorded_data import Part
from armrig.cli.results import Draw, Shown, name_runs

if TYPE_CHECKING:
    from armrig_core.recording_file.manifest import Recovered

    from armrig.cli.replay import Replay
    from armrig.recordings.recording import Recording

_MAX_GAPS, _MAX_NOTES = 3, 10  # lines without --verbose
_MAX_TEXT = 1000  # characters
TIMING_HEIGHT = 2.8  # of a figure, in inches


def info(file: File, part: Part, out: Shown) -> None:
    """Show what a recording contains and how well it was sampled."""
    from armrig.recordings.loading import load

    out.check(file)
    recording = load(file, part.calibration, start=part.start, stop=part.stop)
    name_runs(recording)

    def say_next_command() -> None:
        if recording.N:
            say_next("info", file=typed(file))

    out.show(
        facts=lambda: _recording_facts(recording),
        say=lambda: print_table(*_recording_rows(recording, verbose=out.verbose), verdict=True),
        figures=lambda: timing_figures(recording),
        say_next=say_next_command,
        height=TIMING_HEIGHT,
    )


def _recording_facts(rec: Recording) -> dict[str, Any]:
    from armrig.recordings.jitter import disturbances, sampling_statistics
    from armrig.recordings.usability import data_verdict, doubts_of_calibration

    return {
        **fields_of(rec, "sha256 manifest"),
        "emulated": rec.manifest.emulated,
        **fields_of(rec, "outcome recovered"),
        "samples": int(rec.samples.size),
        "missing": rec.missing,
        "invalid": rec.hidden,
        **fields_of(rec, "truncated damage"),
        "sampling": sampling_statistics(rec),
        "causes": disturbances(rec),
        "calibration": rec.calibration,
        "remarks": doubts_of_calibration(rec.calibration, rec.manifest),
        "verdict": data_verdict(rec).facts(),
        **fields_of(rec, "gaps events notes"),
    }


def _recording_rows(rec: Recording, *, verbose: bool) -> Iterator[tuple[str, str]]:
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
    return f"{text}; spread of the sampling interval, by the device's clock" if spread.n else text


def _lateness(spread: Any, pacing: str) -> str:
    text = _microseconds(spread, 1)
    if spread.n == 0:
        return text
    if pacing == "scheduled":
        return f"{text}; arrival of the samples at the host, which does not affect them"
    return f"{text}; lateness of the host's request for each sample"


def timing_figures(recording: Recording) -> dict[str, Draw]:
    """Return the functions that draw the jitter and the lateness of a recording."""
    from armrig.recordings.figures import plot_timing

    draw = partial(plot_timing, recording)
    return {"jitter": draw, "lateness": partial(draw, quantity="lateness")}


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
