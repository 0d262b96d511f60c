"""Runs and their recordings: file, beginning, contents and end."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from armrig_core.commands.codes import Ending, OutcomeCode, RefusalCode
from armrig_core.commands.commands import (
    CommandRefusedError,
    LastRun,
    Refused,
    Renew,
    RunAccepted,
    build_refusal,
)
from armrig_core.process.printable import plural
from armrig_core.recording_file.manifest import (
    CALIBRATION,
    CALIBRATION_RAW,
    CONFIG,
    CONTROLLER,
    DESCRIPTION,
    Manifest,
)
from armrig_core.recording_file.recorder import ActiveRecording
from armrig_core.rig.calibration import Calibration
from armrig_core.rig.calibration_file import raw_samples
from armrig_core.rig.description import Description, builtin
from armrig_core.telemetry.telemetry import Outgoing
from armrig_protocol.messages import SCHEMA_HASH, VERSION
from msgspec import UNSET

from armrig_daemon import pipe
from armrig_daemon.config import Config
from armrig_daemon.pipe import Gap, RunStarted, State
from armrig_daemon.service.client_watchdog import ClientWatchdog, begin_watch, renew_watch
from armrig_daemon.service.host.host_facts import HostFacts, check_directory, of_this_host
from armrig_daemon.service.plan import RunPlan

_BYTES_PER_SAMPLE = 200  # largest size of a recorded sample, uncompressed and indexed
_BYTES_PER_DECISION = 120  # of a control law
_BYTES_PER_SECOND = 4000  # of the core's inputs and its reports, which do not depend on Ts
_BASE_BYTES = 1 << 20  # size of a recording without samples
_MOST_DROPPED = 2  # recordings that never began and whose threads still wait for the disk
_MODE = 0o640  # the group may read a recording; only the daemon's user may change it
_VERSION = version("armrig")  # read once, because it is read from a file


class Planned(NamedTuple):
    """Run whose file is being created, or that has not begun."""

    run_id: str
    plan: RunPlan
    recording: ActiveRecording


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
        self.description = description or builtin("arm")
        """Description of the rig."""
        self._config = config
        self._circumstances = circumstances or of_this_host()
        self._directory = directory
        self._changed = changed
        self._calibration_raw = raw_samples(config.calibration)
        self._planned: Planned | None = None
        self._recording: ActiveRecording | None = None
        self._finishing: ActiveRecording | None = None
        self._first = self._end = 0
        self._last: LastRun | None = None
        self.has_lost = False
        """True if a recording failed before all its samples were on the disk."""
        self._presence: ClientWatchdog | None = None
        self._early_notes: list[Outgoing] = []  # of a run that was requested and has not begun
        self._is_expected = False
        self._dropped: list[ActiveRecording] = []  # their threads may still wait for the disk

    @property
    def config(self) -> Config:
        """Configuration with the calibration in force."""
        return self._config

    @property
    def last(self) -> LastRun | None:
        """Newest run, including the current run."""
        if self._planned is not None:
            return _new_last_run(self._planned)
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
    def is_expected(self) -> bool:
        """True while a run is planned that was requested; its notes are kept for its recording."""
        return self._is_expected

    @is_expected.setter
    def is_expected(self, value: bool) -> None:
        self._is_expected = value
        if not value and self._planned is None:
            self._early_notes = []

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

    def objection(self) -> Refused | None:
        """Return the refusal of a run because of another run or a silent disk, or None."""
        if not self.is_idle:
            busy = "an experiment is running: stop it first, or wait for its end"
            return build_refusal(RefusalCode.RUNNING, busy)
        self._dropped = [recording for recording in self._dropped if not recording.done]
        if len(self._dropped) >= _MOST_DROPPED:
            silent = f"{self._directory}: the disk does not answer; wait until it does, or set "
            silent += "[recording] directory to another disk"
            return build_refusal(RefusalCode.NO_ROOM, silent)
        return None

    def open(
        self, plan: RunPlan, Ts: float, *, waits: bool = False
    ) -> tuple[pipe.Run, RunAccepted]:
        """Have the file of a run created; return the order to the loop, and the client's answer.

        `Ts` is the sampling time of the lease in s. The order may leave when `opened` is True. If
        `waits` is True, the file exists at the return.

        Raises CommandRefusedError if another run is requested or running, or the file that was
        waited for cannot be created. The exception is a ValueError.
        """
        if objection := self.objection():
            raise CommandRefusedError(objection)
        options, is_control = plan.options, plan.law is not UNSET
        run_id = self._circumstances.run_id(plan.source)
        stamp = self._circumstances.now(plan.zone).strftime("%Y%m%dT%H%M%S")
        name = f"{self._config.rig.id}-{options.experiment}-{stamp}-{run_id}.mcap"
        each = _BYTES_PER_SAMPLE + (_BYTES_PER_DECISION if is_control else 0)
        needed = round(plan.samples * (each + _BYTES_PER_SECOND * Ts)) + _BASE_BYTES
        recording = ActiveRecording(
            self._directory / name,
            changed=self._changed,
            check=partial(_no_room, self._directory, needed),
            mode=_MODE,
            part_samples=part_samples(self._config.recording.part_minutes, plan.samples, Ts),
        )
        self._planned = Planned(run_id, plan, recording)
        self._is_expected = False
        if waits:
            recording.wait_for_file()
            self.is_file_ready()
        order = pipe.Run(
            lease=options.lease,
            n=options.n,
            run_id=run_id,
            codes=b"" if is_control else plan.source,
            scheduled=options.pacing == "scheduled",
            law=plan.law.program(self.description) if plan.law else UNSET,
            reference=plan.source if is_control else UNSET,
            r_range=plan.r_range,
        )
        path = str(recording.path)
        return order, RunAccepted(run_id=run_id, recording=path, rehearsal=plan.rehearsal)

    def is_file_ready(self) -> bool:
        """Return whether the file of the planned run exists.

        Raises CommandRefusedError if the file cannot be created; the run is then forgotten.
        """
        if self._planned is None:
            overtaken = "the run was overtaken by another: arm, and send it again"
            raise CommandRefusedError(build_refusal(RefusalCode.OVERTAKEN, overtaken))
        recording = self._planned.recording
        if recording.error:
            self.forget(self._planned.run_id)
            raise CommandRefusedError(build_refusal(RefusalCode.NO_ROOM, recording.error))
        return recording.is_created

    def renew(self, sign: Renew, now_s: float) -> None:
        """Accept a sign of life; raise ValueError if the current run belongs to another client."""
        self._presence = renew_watch(self._presence, sign, now_s)

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
            recording = self._planned.recording
            recording.discard()
            self._dropped.append(recording)
            self._planned = None
            self._early_notes = []

    def begin(
        self, started: RunStarted, state: State, host: dict[str, Any], clock_offset_ns: int
    ) -> Path:
        """Begin the recording of the run that starts; return the path of the unfinished file.

        Raises LookupError if no client has requested this run.
        """
        planned = self._planned
        if planned is None or planned.run_id != started.run_id:
            self.forget(planned.run_id if planned else "")
            raise LookupError(f"run {started.run_id} was not requested")
        early_notes, self._early_notes = self._early_notes, []
        self._planned = None
        manifest = self._manifest(planned, started, state, host, clock_offset_ns)
        attachments = {
            CONFIG: msgspec.json.encode(self._config),
            CALIBRATION: msgspec.json.encode(self._config.calibration),
            DESCRIPTION: self.description.text,
            manifest.source: planned.plan.text,
        }
        if planned.plan.law:
            attachments[CONTROLLER] = planned.plan.law.text
        if self._calibration_raw:
            attachments[CALIBRATION_RAW] = self._calibration_raw
        self._last = _new_last_run(planned)
        self._first, self._end = started.k_first, started.k_first + started.count
        self._recording = planned.recording
        self._recording.begin(manifest, attachments, t_first_ns=started.t_host_ns)
        self._recording.add(early_notes)
        self._presence = begin_watch(planned.plan.options, time.monotonic())
        return self._recording.active

    @property
    def takes_notes(self) -> bool:
        """True from the request of a run until its recording ends."""
        if self._recording is None:
            return self._planned is not None or self._is_expected
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
        if self._recording is None and self.takes_notes:
            self._early_notes.append(note)
        else:
            self.add([note])

    def end(self, ended: Ending) -> None:
        """End the recording; its writer finishes the file."""
        if self._planned is not None:
            self.forget(self._planned.run_id)
        self._presence = None
        recording, self._recording = self._recording, None
        if recording is None or self._last is None:
            return
        recording.finish(ended)
        self._last = msgspec.structs.replace(self._last, outcome=ended.text, code=ended.code)
        self._finishing = recording

    def recording_failure(self) -> Ending | None:
        """Return the outcome if the run must end because its recording failed or was moved."""
        recording = self._recording
        if recording is None:
            return None
        recording.look()
        if recording.error:
            return Ending(OutcomeCode.RECORDING, recording.error)
        return Ending(OutcomeCode.MOVED, recording.moved) if recording.moved else None

    def completion_line(self, timeout: float = 0.0) -> tuple[str, str]:
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
        text = f"recorded {recording.kept}: {outcome}, {plural(recording.synced, 'sample')}, "
        return "info", f"{text}{recording.missing} missing"

    def wait_for_dropped(self, timeout: float) -> None:
        """Wait for the removal of files of runs that never began, for at most `timeout` s."""
        until_s = time.monotonic() + timeout
        for recording in self._dropped:
            recording.join(max(0.0, until_s - time.monotonic()))

    def _manifest(
        self,
        planned: Planned,
        started: RunStarted,
        state: State,
        host: dict[str, Any],
        clock_offset_ns: int,
    ) -> Manifest:
        config, options, raw = self._config, planned.plan.options, self._calibration_raw
        law = planned.plan.law
        return Manifest(
            rig=config.rig.id,
            run_id=planned.run_id,
            experiment=options.experiment,
            details=options.details,
            owner=state.owner,
            owner_checked=state.owner_checked,
            Ts=state.ts_us / 1e6,
            samples=planned.plan.samples,
            k_first=started.k_first,
            pacing=options.pacing,
            started=self._circumstances.now(planned.plan.zone).isoformat(timespec="milliseconds"),
            clock_offset_ns=clock_offset_ns,
            armrig=_VERSION,
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
            description_sha256=self.description.sha256,
            calibration_raw_sha256=hashlib.sha256(raw).hexdigest() if raw else "",
            input_sha256=planned.plan.text_sha256,
            controller_sha256="" if law is None else law.sha256 if law else UNSET,
            rehearsal=planned.plan.rehearsal,
        )


def _no_room(directory: Path, needed: int) -> str:
    objection = check_directory(directory, needed)
    return objection.error if objection else ""


def part_samples(minutes: float, samples: int, Ts: float) -> int:
    """Return the number of samples of each part of a run; 0 if one file contains the whole run."""
    if not minutes or samples * Ts <= minutes * 60:
        return 0
    most = max(1, round(minutes * 60 / Ts))
    return most if most < samples else 0


def _new_last_run(planned: Planned) -> LastRun:
    return LastRun(
        run_id=planned.run_id,
        recording=str(planned.recording.active),
        finished=False,
        samples=0,
        outcome="",
    )
