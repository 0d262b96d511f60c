"""Runs and their recordings: plan, beginning, contents and end."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Sequence
from importlib.metadata import version
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from armrig_core.commands.codes import Ending, OutcomeCode, RefusalCode
from armrig_core.commands.commands import (
    CommandRefusedError,
    LastRun,
    Refused,
    Rehearsal,
    Renew,
    Run,
    RunAccepted,
    refused,
)
from armrig_core.errors import InputError
from armrig_core.recording_file.manifest import (
    CALIBRATION,
    CALIBRATION_RAW,
    CONFIG,
    DESCRIPTION,
    INPUT,
    Manifest,
)
from armrig_core.recording_file.recorder import Recording, RecordingError
from armrig_core.rig.calibration import Calibration
from armrig_core.rig.calibration_file import raw_samples
from armrig_core.rig.description import Description, shipped
from armrig_core.rig.volts import codes_of
from armrig_core.telemetry.telemetry import Outgoing
from armrig_protocol.messages import SCHEMA_HASH, VERSION
from numpy.typing import NDArray

from armrig_daemon import pipe
from armrig_daemon.config import Config, Limits
from armrig_daemon.pipe import Gap, RunStarted, State
from armrig_daemon.service.client_watchdog import ClientWatchdog, begun, renewed
from armrig_daemon.service.host.host_facts import HostFacts, check_directory, of_this_host

_BYTES_PER_SAMPLE = 200  # largest size of a recorded sample, uncompressed and indexed
_BYTES_PER_SECOND = 4000  # of the core's inputs and its reports, which do not depend on Ts
_BASE_BYTES = 1 << 20  # size of a recording without samples


class Planned(NamedTuple):
    """Run that was requested and has not begun."""

    run_id: str
    path: Path
    request: Run
    rehearsal: Rehearsal | None
    """Response of the model to the input; None for a rig without a model."""
    text: bytes
    """Input as text for the recording; the slow conversion is done before the run, at 0 V."""


class Runs:
    """Current run, if any, and the last run."""

    def __init__(
        self,
        config: Config,
        directory: Path,
        changed: Callable[[], None],
        circumstances: HostFacts | None = None,
        description: Description | None = None,
    ) -> None:
        """Record into `directory`; the thread of a recording calls `changed` after each change.

        The default of `description` is the description of the arm.
        """
        self._description = description or shipped("arm")
        self._config = config
        self._circumstances = circumstances or of_this_host()
        self._directory = directory
        self._changed = changed
        self._calibration_raw = raw_samples(config.calibration)
        self._planned: Planned | None = None
        self._recording: Recording | None = None
        self._finishing: Recording | None = None
        self._first = self._end = 0
        self._last: LastRun | None = None
        self.has_lost = False
        """True if a recording failed before all its samples were on the disk."""
        self._presence: ClientWatchdog | None = None
        self._early_notes: list[Outgoing] = []  # of a run that was requested and has not begun

    @property
    def last(self) -> LastRun | None:
        """Newest run, including the current run."""
        if self._planned is not None:
            return _begun(self._planned)
        recording = self._recording or self._finishing
        if self._last is None or recording is None:
            return self._last
        return msgspec.structs.replace(
            self._last,
            recording=str(recording.kept),
            samples=recording.samples,
            synced=recording.synced,
        )

    @property
    def run_id(self) -> str:
        """Id of the current run, or an empty text."""
        return "" if self.is_idle or self.last is None else self.last.run_id

    @property
    def is_idle(self) -> bool:
        """True without a current run."""
        return self._planned is None and self._recording is None and self._finishing is None

    def no_room(self) -> Refused | None:
        """Return the refusal if nothing can be recorded, or None."""
        return check_directory(self._directory, _BASE_BYTES)

    def note_calibration(self, calibration: Calibration, raw: bytes) -> None:
        """Use another calibration; all later recordings contain it and its samples."""
        self._config = msgspec.structs.replace(self._config, calibration=calibration)
        self._calibration_raw = raw

    def plan(
        self,
        request: Run,
        Ts: float,
        start_rad: float | None = None,
        alive: Callable[[], None] = lambda: None,
    ) -> tuple[pipe.Run, RunAccepted]:
        """Return the order to the loop, and the answer to the client if the loop accepts the order.

        `request` is the request of the client, `Ts` the sampling time of the lease in s, and
        `start_rad` the angle of the turning shaft in rad. `alive` is called after each slow step,
        because the plan may take seconds.

        Raises CommandRefusedError if another run is requested or running, or there is no room for
        the recording. The exception is a ValueError. Raises ValueError if a voltage or the
        rehearsal is outside the limits.
        """
        if not self.is_idle:
            busy = "an experiment is running: stop it first, or wait for its end"
            raise CommandRefusedError(refused(RefusalCode.RUNNING, busy))
        no_room = check_directory(self._directory, _most_bytes(len(request.u), Ts) + _BASE_BYTES)
        if no_room:
            raise CommandRefusedError(no_room)
        u = checked(request.u, self._config.limits)
        alive()
        rehearsal = self._config.rehearsal(u, Ts, self._description, start_rad)
        alive()
        text = one_a_line(u)
        alive()
        codes = codes_of(u.tolist())
        alive()
        run_id = self._circumstances.run_id(codes)
        stamp = self._circumstances.now().strftime("%Y%m%dT%H%M%S")
        name = f"{self._config.rig.id}-{request.experiment}-{stamp}-{run_id}.mcap"
        self._planned = Planned(run_id, self._directory / name, request, rehearsal, text)
        order = pipe.Run(
            lease=request.lease,
            n=request.n,
            run_id=run_id,
            codes=codes,
            scheduled=request.pacing == "scheduled",
        )
        path = str(self._planned.path)
        return order, RunAccepted(run_id=run_id, recording=path, rehearsal=rehearsal)

    def renew(self, sign: Renew, now_s: float) -> None:
        """Accept a sign of life; raise ValueError if the current run belongs to another client."""
        self._presence = renewed(self._presence, sign, now_s)

    @property
    def client_gone_s(self) -> float:
        """Monotonic time, in s, at which the run is stopped if no further sign of life arrives."""
        return self._presence.gone_s if self._presence else inf

    def client_gone(self) -> Ending:
        """Return the outcome of a run that is stopped because its client is gone."""
        presence, self._presence = self._presence, None
        period_s = presence.period_s if presence else 0.0
        text = f"its client went away: no sign of it for {period_s:g} s"
        return Ending(OutcomeCode.CLIENT_GONE, text)

    def forget(self, run_id: str) -> None:
        """Discard a planned run that the loop has refused or has not answered."""
        if self._planned is not None and self._planned.run_id == run_id:
            self._planned = None
            self._early_notes = []

    def begin(
        self, started: RunStarted, state: State, host: dict[str, Any], clock_offset_ns: int
    ) -> Path:
        """Open the recording of the run that starts; return the path of the unfinished file.

        Raises RecordingError if the file cannot be created. Raises LookupError if no client has
        requested this run.
        """
        planned, self._planned = self._planned, None
        early_notes, self._early_notes = self._early_notes, []
        if planned is None or planned.run_id != started.run_id:
            raise LookupError(f"run {started.run_id} was not requested")
        manifest = self._manifest(planned, started, state, host, clock_offset_ns)
        attachments = {
            CONFIG: msgspec.json.encode(self._config),
            CALIBRATION: msgspec.json.encode(self._config.calibration),
            DESCRIPTION: self._description.text,
            INPUT: planned.text,
        }
        if self._calibration_raw:
            attachments[CALIBRATION_RAW] = self._calibration_raw
        self._last = _begun(planned)
        self._first, self._end = started.k_first, started.k_first + started.count
        try:
            self._recording = Recording(
                planned.path,
                manifest,
                attachments,
                t_first_ns=started.t_host_ns,
                changed=self._changed,
                part_samples=part_samples(
                    self._config.recording.part_minutes, manifest.samples, manifest.Ts
                ),
            )
        except RecordingError as err:
            self._last = msgspec.structs.replace(
                self._last, finished=True, outcome=str(err), code=OutcomeCode.RECORDING
            )
            raise
        self._recording.add(early_notes)
        self._presence = begun(planned.request, time.monotonic())
        return self._recording.active

    @property
    def takes_notes(self) -> bool:
        """True from the request of a run until its recording ends."""
        if self._recording is None:
            return self._planned is not None
        return not self._recording.error

    def includes_sample(self, k: int) -> bool:
        """Return whether the recording includes sample `k`."""
        return self._recording is not None and self._first <= k < self._end

    def includes(self, record: object) -> bool:
        """Return whether the recording includes a record; a gap must overlap with the run."""
        if self._recording is None or not isinstance(record, Gap):
            return self._recording is not None
        return max(record.k_first, self._first) < min(record.k_first + record.count, self._end)

    def add(self, batch: list[Outgoing]) -> None:
        """Record messages, if there is a recording."""
        if self._recording is not None and batch:
            self._recording.add(batch)

    def add_note(self, note: Outgoing) -> None:
        """Record a note; the recording of a requested run gets the note when it begins."""
        if self._recording is None and self._planned is not None:
            self._early_notes.append(note)
        else:
            self.add([note])

    def end(self, ended: Ending) -> None:
        """End the recording; its writer finishes the file."""
        self._planned = self._presence = None
        self._early_notes = []
        recording, self._recording = self._recording, None
        if recording is None or self._last is None:
            return
        recording.finish(ended)
        self._last = msgspec.structs.replace(self._last, outcome=ended.text, code=ended.code)
        self._finishing = recording

    def disturbed(self) -> Ending | None:
        """Return the outcome if the run must end because its recording failed or was moved."""
        recording = self._recording
        if recording is None:
            return None
        recording.look()
        if recording.error:
            return Ending(OutcomeCode.RECORDING, recording.error)
        return Ending(OutcomeCode.MOVED, recording.moved) if recording.moved else None

    def finished(self, timeout: float = 0.0) -> tuple[str, str]:
        """Return the level and text of a log line if a recording is complete, else two empty texts.

        After `timeout`, in s, the recording is given up.
        """
        recording = self._finishing
        if recording is None or self._last is None:
            return "", ""
        if timeout:
            recording.join(timeout)
        recording.look()
        if not recording.done:
            return "", ""
        self._finishing = None
        outcome = recording.error or self._last.outcome
        self._last = msgspec.structs.replace(
            self._last,
            recording=str(recording.kept),
            finished=True,
            samples=recording.synced,
            synced=recording.synced,
            outcome=outcome,
            code=OutcomeCode.RECORDING if recording.error else self._last.code,
        )
        if recording.error:
            self.has_lost = self.has_lost or recording.synced < recording.samples
            return "error", recording.error
        text = f"recorded {recording.kept}: {outcome}, {recording.synced} samples, "
        return "info", f"{text}{recording.missing} missing"

    def _manifest(
        self,
        planned: Planned,
        started: RunStarted,
        state: State,
        host: dict[str, Any],
        clock_offset_ns: int,
    ) -> Manifest:
        config = self._config
        return Manifest(
            rig=config.rig.id,
            run_id=planned.run_id,
            experiment=planned.request.experiment,
            details=planned.request.details,
            owner=state.owner,
            owner_checked=state.owner_checked,
            Ts=state.ts_us / 1e6,
            samples=len(planned.request.u),
            k_first=started.k_first,
            pacing=planned.request.pacing,
            started=self._circumstances.now().isoformat(timespec="milliseconds"),
            clock_offset_ns=clock_offset_ns,
            armrig=version("armrig"),
            protocol=f"{VERSION} {SCHEMA_HASH:08x}",
            device=state.device,
            host={
                **self._circumstances.host,
                "port": config.device.port,
                "baud": config.device.baud,
                **host,
            },
            config_sha256=hashlib.sha256(msgspec.json.encode(config)).hexdigest(),
            calibration_sha256=config.calibration_sha256,
            description_sha256=self._description.sha256,
            rehearsal=planned.rehearsal,
        )


def one_a_line(volts: NDArray[np.float64]) -> bytes:
    """Return the input (N,) as text for the recording: a heading, then a voltage per line."""
    # msgspec takes a tenth of the time of repr. For millions of samples, repr would take so long
    # that the loop would consider the service frozen.
    text = msgspec.json.encode(volts.tolist())
    return b"u_v\n" + text[1:-1].replace(b",", b"\n") + b"\n"


def checked(u: Sequence[float], limits: Limits) -> NDArray[np.float64]:
    """Return the voltages of an experiment, (N,) in V.

    Raises ValueError if a voltage is outside the limits, or a step is too large; the message names
    the first index.
    """
    volts = np.asarray(u, dtype=np.float64)
    low, high, slew = limits.u_min_v, limits.u_max_v, limits.slew_v
    outside = ~((volts >= low) & (volts <= high))
    if outside.any():
        i = int(np.argmax(outside))
        raise InputError(f"u[{i}]={volts[i]:.4g} V is outside {low:.4g} … {high:.4g} V")
    steps = np.abs(np.diff(volts, prepend=0.0))
    # The tolerance allows for the rounding error in the difference of two decimal numbers.
    far = steps > slew * (1 + 1e-9)
    if slew and far.any():
        i = int(np.argmax(far))
        raise InputError(f"u[{i}] steps by {steps[i]:.4g} V: at most {slew:.4g} V in a sample")
    return volts


def _most_bytes(samples: int, Ts: float) -> int:
    """Return the largest size of a recording beyond its base, in B."""
    return round(samples * (_BYTES_PER_SAMPLE + _BYTES_PER_SECOND * Ts))


def part_samples(minutes: float, samples: int, Ts: float) -> int:
    """Return the number of samples of each part of a run; 0 if one file contains the whole run."""
    if not minutes or samples * Ts <= minutes * 60:
        return 0
    most = max(1, round(minutes * 60 / Ts))
    return most if most < samples else 0


def _begun(planned: Planned) -> LastRun:
    return LastRun(
        run_id=planned.run_id,
        recording=f"{planned.path}.active",
        finished=False,
        samples=0,
        outcome="",
    )
