"""Loading: from a file's samples, gaps and reports to a recording on a complete grid."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from armrig_core import manifest as records
from armrig_core.calibration import Calibration, Driver, Potentiometer
from armrig_core.calibration_file import CalibrationFileError, read_calibration
from armrig_core.manifest import Manifest, Outcome
from armrig_protocol.messages import Flag
from numpy.typing import NDArray

from armrig.recordings.container import Content, read
from armrig.recordings.daemon_reports import (
    Clock,
    Gap,
    check_whole_numbers,
    device_clock_of,
    event_of,
    gap_of,
    timing_of,
)
from armrig.recordings.grid import Grid, grid
from armrig.recordings.recording import Recording, RecordingError, Vector
from armrig.recordings.sample_rows import DamageError
from armrig.recordings.unwrapping import outside_dead_band, turns_unknown, unwrap

_LONGEST_TS_S = 86_400.0
_ARRAYS = ("t", "u", "theta_1", "alpha", "valid", "valid_alpha", "present")


def load(path: str | Path, calibration: Calibration | str | Path | None = None) -> Recording:
    """Return the recording in a file.

    A file that was cut off or damaged gives what is whole at its beginning, with `truncated`.

    Parameters
    ----------
    path : str or Path
        An MCAP file of armrigd's, also an unfinished one (*.mcap.active).
    calibration : Calibration, str or Path, optional
        What to read the counts and codes with, or the TOML of `armrig calibrate` that says it; left
        out, the calibration that the daemon attached.

    Returns
    -------
    Recording
        N samples: `t` in s, `u` in V, `theta_1` and `alpha` in rad, each (N,).

    Raises
    ------
    RecordingError
        The file is no MCAP, no recording, or damaged before its first sample; or the calibration
        cannot be read.
    OSError
        The file cannot be opened or read.
    """
    path = Path(path)
    try:
        if isinstance(calibration, (str, Path)):
            calibration = read_calibration(Path(calibration))
    except CalibrationFileError as err:
        raise RecordingError(str(err)) from err
    try:
        content = read(path)
    except DamageError as err:
        msg = f"{path}: {err}; armrig reads what armrigd has recorded (*.mcap); "
        msg += "identify, validate and check read other data, too (.csv, .dat, .mat, .npz)"
        raise RecordingError(msg) from err
    if content is None:
        msg = f"{path}: not an MCAP file; armrig reads what armrigd has recorded (*.mcap); "
        msg += "identify, validate and check read other data, too (.csv, .dat, .mat, .npz)"
        raise RecordingError(msg)
    entries = content.metadata.get(records.RUN)
    if entries is None:
        why = content.damage or "it holds no metadata named armrig.run"
        msg = f"{path}: not a recording of a run: {why}"
        raise RecordingError(msg)
    try:
        manifest = records.manifest_of(entries)
        outcome = content.metadata.get(records.OUTCOME)
        ended = None if outcome is None else records.outcome_of(outcome)
        attached = _calibration(content)
        check_whole_numbers(manifest)
        if ended is not None:
            check_whole_numbers(ended)
    except (msgspec.DecodeError, ValueError, RecursionError, OverflowError) as err:
        msg = f"{path}: its manifest or calibration is not armrig's: {_first_line(err)}"
        raise RecordingError(msg) from err
    if not 0 < manifest.Ts < _LONGEST_TS_S:
        msg = f"{path}: its manifest says Ts={manifest.Ts!r} s, which must be > 0 and below a day"
        raise RecordingError(msg)
    return _assembled(path, content, manifest, ended, calibration or attached)


def _first_line(err: Exception) -> str:
    return (str(err).splitlines() or [type(err).__name__])[0][:300]


def _calibration(content: Content) -> Calibration | None:
    text = content.attachments.get(records.CALIBRATION)
    return None if text is None else msgspec.json.decode(text, type=Calibration)


def _assembled(
    path: Path,
    content: Content,
    manifest: Manifest,
    outcome: Outcome | None,
    calibration: Calibration | None,
) -> Recording:
    samples, messages = content.samples, content.messages
    try:
        spots = [(int(m.k_first), int(m.count)) for m in messages.get("gap", [])]
        # The rest of a damaged file is not missing: its samples may have come, but are not here.
        rows = grid(samples["k"], manifest, None if content.damage else outcome, spots)
    except ValueError as err:
        msg = f"{path}: {err}"
        raise RecordingError(msg) from err
    clock = _clock(content, manifest, rows.k_first)
    gaps = tuple(gap_of(message, clock) for message in messages.get("gap", []))
    saved = f"; saved: {samples.size} samples, {content.read} of {content.size} B, "
    saved += f"{rows.N * manifest.Ts:g} s of {max(manifest.samples, 0) * manifest.Ts:g} s"
    recording = Recording(
        path=path,
        sha256=content.sha256,
        manifest=manifest,
        outcome=outcome,
        calibration=calibration,
        k_first=rows.k_first,
        t=np.arange(rows.N, dtype=np.float64) * np.float64(manifest.Ts),
        u=_terminal(_input(samples, rows, gaps), calibration.driver if calibration else Driver()),
        **_angles(samples, rows, calibration, manifest.Ts),
        present=rows.present,
        samples=samples,
        gaps=gaps,
        events=tuple(event_of(message, clock) for message in messages.get("event", [])),
        timing=tuple(timing_of(message, clock) for message in messages.get("timing", [])),
        clock=tuple(device_clock_of(message, clock) for message in messages.get("clock", [])),
        truncated=bool(content.damage),
        cut_off=content.cut_off,
        damage=content.damage + saved if content.damage else "",
    )
    for array in (*(getattr(recording, name) for name in _ARRAYS), samples):
        array.flags.writeable = False
    return recording


def _clock(content: Content, manifest: Manifest, k_first: int) -> Clock:
    """Return the clock whose zero is when sample `k_first` was due."""
    if content.samples.size:
        k, due_ns = (int(content.samples[name][0]) for name in ("k", "t_sched_ns"))
    elif content.messages.get("gap"):
        gap = content.messages["gap"][0]
        k, due_ns = gap.k_first, gap.t_from_ns
    else:
        k, due_ns = k_first, 0
    zero_ns = due_ns - round((k - k_first) * manifest.Ts * 1e9)
    return Clock(zero_ns=zero_ns, offset_ns=manifest.clock_offset_ns)


def _input(samples: NDArray[np.void], rows: Grid, gaps: tuple[Gap, ...]) -> Vector:
    """Return u (N,) in V: as applied, or as held while samples were missing, else NaN."""
    u = rows.filled((gap.k_first, gap.count, gap.u_held_v) for gap in gaps)
    u[rows.rows] = samples["u_applied_v"]
    return u


def _terminal(u: Vector, driver: Driver) -> Vector:
    """Return the voltage at the motor's terminals for that of the codes, in V; 0 V is off."""
    return np.where(u == 0, 0.0, driver.gain * u + driver.offset_v)


def _angles(
    samples: NDArray[np.void], rows: Grid, calibration: Calibration | None, Ts: float
) -> dict[str, Any]:
    """Return theta_1, alpha, where they are valid, and where the turns are not known."""
    theta_1, alpha = np.full(rows.N, np.nan), np.full(rows.N, np.nan)
    present = rows.present
    valid, valid_alpha = present.copy(), present.copy()
    rails = samples["flags"]
    valid[rows.rows] = outside_dead_band((rails & Flag.ADC0_RAIL) != 0)
    valid_alpha[rows.rows] = (rails & Flag.ADC1_RAIL) == 0
    pots = (calibration.theta_1, calibration.alpha) if calibration else (None, None)
    theta_1[rows.rows] = _angle(samples, "theta_1", pots[0])
    alpha[rows.rows] = _angle(samples, "alpha", pots[1])
    valid &= np.isfinite(theta_1)
    valid_alpha &= np.isfinite(alpha)
    alpha[~valid_alpha] = np.nan
    turns = pots[0] is None or pots[0].wraps
    if turns:
        theta_1 = unwrap(theta_1, valid)
    theta_1[~valid] = np.nan
    unknown = turns_unknown(valid, present, Ts).tolist() if turns else []
    return {
        "theta_1": theta_1,
        "alpha": alpha,
        "valid": valid,
        "valid_alpha": valid_alpha,
        "turns_unknown": tuple(unknown),
    }


def _angle(samples: NDArray[np.void], name: str, pot: Potentiometer | None) -> Vector:
    if pot is None:
        return np.asarray(samples[f"{name}_rad"], np.float64)
    counts = samples[f"{name}_counts"].astype(np.float64)
    return np.asarray((counts - pot.zero_counts) * pot.rad_per_count)
