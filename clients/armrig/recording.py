"""A recording: what the rig did in one run, on a complete grid of samples."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
from armrig_core import manifest as records
from armrig_core.calibration import Calibration, Potentiometer
from armrig_core.manifest import Manifest, Outcome
from armrig_protocol.messages import Flag
from numpy.typing import NDArray

from armrig.container import Content, read
from armrig.dataset import Dataset
from armrig.preprocess import difference
from armrig.unwrapping import outside_dead_band, turns_unknown, unwrap

Vector = NDArray[np.float64]
Mask = NDArray[np.bool_]

OUTPUTS = ("theta_1", "alpha", "velocity")

# A grid is made for the missing samples, too: a file of two samples must not ask for 10^18 of them.
_MISSING_LIMIT, _MISSING_PER_SAMPLE = 200_000, 10
_LEVELS = ("unknown", "debug", "info", "warning", "error", "fatal")


class RecordingError(ValueError):
    """A file that cannot be read as a recording; says what it is instead."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Gap:
    """Samples that are missing."""

    k_first: int
    """Index of the first of them."""
    count: int
    """How many."""
    t: float
    """When the first was due, in s from the recording's first sample."""
    u_held_v: float
    """Voltage that the motor kept meanwhile, in V."""
    reason: str
    """Why they are missing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """What the daemon had to say."""

    t: float
    """When, in s from the recording's first sample."""
    level: str
    """info, warning, error or fatal."""
    message: str
    """What happened."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Distribution:
    """How a time in µs was distributed over one second."""

    p50: float
    p90: float
    p99: float
    p999: float
    max: float
    n: int
    """How many there were."""
    missed: int
    """How many were not in time at all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """Timing as the daemon measured it while it ran."""

    t: float
    """When, in s from the recording's first sample."""
    wake_lateness_us: Distribution
    """Of the host, against the sample's deadline."""
    device_tick_error_us: Distribution
    """Of the device's clock, against the sampling time."""
    link_round_trip_us: Distribution
    """Of the link."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Recording:
    """What the rig did in one run; row i of every array is the sample k_first + i.

    The grid is complete: where a sample is missing its row is there, with `theta_1` and `alpha`
    NaN, so that no formula can use it unseen.
    """

    path: Path
    """Where it was read from."""
    sha256: str
    """Hash of the file, all of it."""
    manifest: Manifest
    """How the run was made."""
    outcome: Outcome | None
    """How it ended; None where the file was cut off before."""
    calibration: Calibration | None
    """Counts to angles; None where it is missing, and then the daemon's angles are used."""
    t: Vector
    """Time in s from the first sample, (N,)."""
    u: Vector
    """Motor voltage in V that the device held from `t` on, (N,).

    Where a sample is missing: what its gap record says was held; NaN without a record.
    """
    theta_1: Vector
    """Angle of the chassis in rad with its turns counted, (N,); NaN where it is not `valid`."""
    alpha: Vector
    """Angle of the arm against the chassis in rad, (N,); NaN where it is not `valid_alpha`."""
    valid: Mask
    """(N,): False for theta_1 in the dead band, at the first sample after it, and where missing."""
    valid_alpha: Mask
    """(N,): False for alpha at a rail and where the sample is missing.

    The dead band of theta_1 does not matter to it; and as alpha does not turn on, the sample after
    a rail is as good as any.
    """
    present: Mask
    """(N,): the sample came."""
    turns_unknown: tuple[int, ...]
    """Rows from which on theta_1 may be wrong by whole turns: samples were missing for too long."""
    samples: NDArray[np.void]
    """The samples as recorded, raw counts and all times, a structured array of those that came."""
    gaps: tuple[Gap, ...]
    """Missing samples, as the daemon recorded them."""
    events: tuple[Event, ...]
    """What the daemon had to say."""
    timing: tuple[Timing, ...]
    """Timing, once a second."""
    truncated: bool
    """The file is not whole: see `damage`."""
    damage: str
    """What is wrong with the file and how much was saved; "" for a whole one."""

    @property
    def N(self) -> int:
        """Number of samples, missing ones included."""
        return int(self.t.size)

    @property
    def Ts(self) -> float:
        """Sampling time, in s."""
        return self.manifest.Ts

    @property
    def missing(self) -> int:
        """Number of samples that did not come."""
        return self.N - int(self.samples.size)

    @property
    def short_hash(self) -> str:
        """First twelve digits of the hash, as figures carry it."""
        return self.sha256[:12]

    def dataset(self, output: Literal["theta_1", "alpha", "velocity"] = "theta_1") -> Dataset:
        """Return u and one output to identify from, with what is missing marked.

        A sample whose input is not known is left out, and after it, as where the number of turns
        is not known, a new experiment begins.

        Parameters
        ----------
        output : {"theta_1", "alpha", "velocity"}
            The angle of the chassis, that of the arm, or the rate of the first from differences.

        Raises
        ------
        RecordingError
            There is no valid sample, or no such output.
        """
        if output not in OUTPUTS:
            msg = f"output={output!r}: a recording has {', '.join(OUTPUTS)}"
            raise RecordingError(msg)
        y, valid = (
            (self.alpha, self.valid_alpha) if output == "alpha" else (self.theta_1, self.valid)
        )
        known = np.isfinite(self.u)
        if not (valid & known).any():
            msg = f"{self.path}: none of its {self.N} samples shows {output}; record again"
            raise RecordingError(msg)
        begins = ~known
        begins[1:] = ~known[:-1]
        begins[:1] = True
        if output != "alpha":
            begins[list(self.turns_unknown)] = True
        data = Dataset(
            u=self.u[known],
            y=y[known],
            Ts=self.Ts,
            valid=valid[known],
            starts=np.flatnonzero(begins[known]).tolist() or [0],
            output="alpha" if output == "alpha" else "theta_1",
            unit="rad",
            source=self.sha256,
        )
        return difference(data) if output == "velocity" else data

    def __repr__(self) -> str:
        """Say it in a line."""
        parts = [f"{self.manifest.experiment}, {self.N} samples at {self.Ts:g} s"]
        parts += [f"{self.missing} missing"] if self.missing else []
        hidden = int(np.count_nonzero(self.present & ~self.valid))
        parts += [f"{hidden} in the dead band"] if hidden else []
        parts += [self.damage] if self.truncated else []
        return f"<Recording {self.short_hash}: {'; '.join(parts)}>"


def load(path: str | Path) -> Recording:
    """Return the recording in the file at `path`.

    A file that was cut off or damaged gives what is whole at its beginning, with `truncated`.

    Raises
    ------
    RecordingError
        The file is no MCAP, no recording, or damaged before its first sample.
    OSError
        The file cannot be opened or read.
    """
    path = Path(path)
    content = read(path)
    if content is None:
        msg = f"{path}: not an MCAP file; armrig reads what armrigd has recorded (*.mcap)"
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
        calibration = _calibration(content)
    except (msgspec.DecodeError, ValueError) as err:
        msg = f"{path}: its manifest or calibration is not armrig's: {err}"
        raise RecordingError(msg) from err
    if not manifest.Ts > 0:
        msg = f"{path}: its manifest says Ts={manifest.Ts!r} s, which must be > 0"
        raise RecordingError(msg)
    return _assembled(path, content, manifest, ended, calibration)


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
    samples = content.samples
    rows = _rows(path, samples["k"])
    N = int(rows[-1]) + 1 if rows.size else 0
    present = np.zeros(N, np.bool_)
    present[rows] = True

    u = np.full(N, np.nan)
    u[rows] = samples["u_applied_v"]
    clock = _Clock(samples, manifest.clock_offset_ns)
    gaps = tuple(_gap(message, clock) for message in content.messages.get("gap", []))
    k_first = int(samples["k"][0]) if samples.size else 0
    for gap in gaps:
        begin, end = gap.k_first - k_first, gap.k_first - k_first + gap.count
        hole = slice(max(begin, 0), max(min(end, N), 0))
        u[hole] = np.where(present[hole], u[hole], gap.u_held_v)

    theta_1, alpha = np.full(N, np.nan), np.full(N, np.nan)
    valid, valid_alpha = present.copy(), present.copy()
    rails = samples["flags"]
    valid[rows] = outside_dead_band((rails & Flag.ADC0_RAIL) != 0)
    valid_alpha[rows] = (rails & Flag.ADC1_RAIL) == 0
    pots = (calibration.theta_1, calibration.alpha) if calibration else (None, None)
    theta_1[rows] = _angle(samples, "theta_1", pots[0])
    alpha[rows] = _angle(samples, "alpha", pots[1])
    valid &= np.isfinite(theta_1)
    valid_alpha &= np.isfinite(alpha)
    alpha[~valid_alpha] = np.nan
    turns = pots[0] is None or pots[0].wraps
    if turns:
        theta_1 = unwrap(theta_1, valid)
    theta_1[~valid] = np.nan
    unknown = turns_unknown(valid, present, manifest.Ts) if turns else ()

    saved = f"; saved: {samples.size} samples, {content.read} of {content.size} B"
    recording = Recording(
        path=path,
        sha256=content.sha256,
        manifest=manifest,
        outcome=outcome,
        calibration=calibration,
        t=np.arange(N, dtype=np.float64) * np.float64(manifest.Ts),
        u=u,
        theta_1=theta_1,
        alpha=alpha,
        valid=valid,
        valid_alpha=valid_alpha,
        present=present,
        turns_unknown=tuple(int(i) for i in unknown),
        samples=samples,
        gaps=gaps,
        events=tuple(_event(message, clock) for message in content.messages.get("event", [])),
        timing=tuple(_timing(message, clock) for message in content.messages.get("timing", [])),
        truncated=bool(content.damage),
        damage=content.damage and content.damage + saved,
    )
    for array in (*(getattr(recording, name) for name in _ARRAYS), samples):
        array.flags.writeable = False
    return recording


_ARRAYS = ("t", "u", "theta_1", "alpha", "valid", "valid_alpha", "present")


def _rows(path: Path, k: NDArray[np.uint64]) -> NDArray[np.intp]:
    """Return the row of each sample in the complete grid."""
    if not k.size:
        return np.zeros(0, np.intp)
    missing = int(k[-1]) - int(k[0]) + 1 - k.size
    if missing > _MISSING_LIMIT + _MISSING_PER_SAMPLE * k.size:
        msg = f"{path}: its {k.size} samples run from k={k[0]} to {k[-1]}, {missing} are missing: "
        msg += "too many for a recording"
        raise RecordingError(msg)
    return np.asarray(k - k[0], np.intp)


def _angle(samples: NDArray[np.void], name: str, pot: Potentiometer | None) -> Vector:
    if pot is None:
        return np.asarray(samples[f"{name}_rad"], np.float64)
    counts = samples[f"{name}_counts"].astype(np.float64)
    return np.asarray((counts - pot.zero_counts) * pot.rad_per_count)


class _Clock:
    """Host times to seconds from the first sample."""

    def __init__(self, samples: NDArray[np.void], offset_ns: int) -> None:
        self.zero_ns = int(samples["t_sched_ns"][0]) if samples.size else 0
        self.offset_ns = offset_ns

    def seconds(self, host_ns: int) -> float:
        return (host_ns - self.zero_ns) / 1e9


def _gap(message: Any, clock: _Clock) -> Gap:
    return Gap(
        k_first=message.k_first,
        count=message.count,
        t=clock.seconds(message.t_from_ns),
        u_held_v=message.u_held_v,
        reason=message.reason,
    )


def _event(message: Any, clock: _Clock) -> Event:
    stamp = message.timestamp
    real_ns = stamp.seconds * 1_000_000_000 + stamp.nanos
    level = _LEVELS[message.level] if 0 <= message.level < len(_LEVELS) else str(message.level)
    return Event(t=clock.seconds(real_ns - clock.offset_ns), level=level, message=message.message)


def _timing(message: Any, clock: _Clock) -> Timing:
    def distribution(part: Any) -> Distribution:
        return Distribution(**{name: getattr(part, name) for name in Distribution.__slots__})

    return Timing(
        t=clock.seconds(message.t_host_ns),
        wake_lateness_us=distribution(message.wake_lateness_us),
        device_tick_error_us=distribution(message.device_tick_error_us),
        link_round_trip_us=distribution(message.link_round_trip_us),
    )
