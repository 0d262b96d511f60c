"""Runs on an emulated rig in virtual time, requested and recorded as by `armrigd run`.

Loop, core, codec, emulated device and recorder are the same code as for `armrigd run`. There is no
zenoh session, no real-time priority and no terminal. A recording contains no data of the host, so
the same seed results in the same bytes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import msgspec
from armrig_core.commands.codes import Ending
from armrig_core.commands.commands import ControlRequest, RunRequest
from armrig_core.errors import InputError, OperationError
from armrig_core.rig.description import Description, builtin
from armrig_core.rig.emulated import VIRTUAL_PORT
from armrig_core.telemetry.telemetry import Outgoing, decode_sample
from msgspec import UNSET
from msgspec.structs import replace

from armrig_daemon import pipe
from armrig_daemon.config import Config, RecordingTable
from armrig_daemon.emulator.device import Device
from armrig_daemon.pipe import (
    Answer,
    Clock,
    Gap,
    Log,
    Orders,
    Record,
    RunEnded,
    RunStarted,
    State,
    Timing,
    Trace,
)
from armrig_daemon.service.host.host_facts import HostFacts
from armrig_daemon.service.plan import make_control_plan, make_plan, options_of
from armrig_daemon.service.protobuf_out import outgoing
from armrig_daemon.service.runs import Runs
from armrig_daemon.service.thinning import Thinning
from armrig_daemon.virtual import SwitchOn, VirtualRig

LEASE = "0" * 32
"""Lease of the only client; this lease need not be secret."""
BEGINNING = datetime(2000, 1, 1, tzinfo=UTC)
"""Start of virtual time for seed 0; for seed n the start is n seconds later."""
_DISTINCT_SEEDS = 10 * 365 * 86_400  # further seeds repeat the start times
_STEP_NS = 500_000_000
_SETTLE_NS = 10_000_000_000
_FINISH_S = 60.0


class VirtualService:
    """Emulated rig, and the recordings of its runs."""

    def __init__(
        self,
        config: Config,
        directory: Path,
        *,
        seed: int,
        switch_on: SwitchOn = Device,
        description: Description | None = None,
    ) -> None:
        """Switch the rig on; `seed` determines its noise, and the names and times of the runs.

        `description` describes the rig; default: the arm.
        """
        emulator = replace(config.emulator, seed=seed, baud=config.device.baud)
        # Folders and port depend on the host. Without them, the same rig gives the same file.
        rig = replace(config.rig, file=UNSET)  # the description itself is attached
        device = replace(config.device, port=VIRTUAL_PORT)
        self._config = replace(
            config, rig=rig, device=device, emulator=emulator, recording=RecordingTable()
        )
        self._began = BEGINNING + timedelta(seconds=seed % _DISTINCT_SEEDS)
        self._offset_ns = int(self._began.timestamp()) * 1_000_000_000
        self._rig = VirtualRig(self._config.rules(description), emulator, switch_on=switch_on)
        circumstances = HostFacts(
            run_id=lambda codes: _name(seed, codes),
            now=lambda _: self._began + timedelta(microseconds=self._rig.ports.now // 1000),
            host={"time": "virtual", "seed": seed},
        )
        self._description = description or builtin("arm")
        self._runs = Runs(self._config, directory, lambda: None, circumstances, description)
        self._thinning = Thinning()
        self._n = 0
        self._state: State | None = None
        self._answers: dict[int, Answer] = {}
        self._has_ended = self._has_sample = False

    def record(self, request: RunRequest | ControlRequest) -> Path:
        """Arm, play or control, and record a run; return the path of the complete recording.

        The lease and the number of `request` are replaced.

        Raises OperationError if the run was refused, or ended before its last sample. Raises
        ValueError if a voltage or the rehearsal is outside the limits, or nothing can be recorded.
        """
        self._until(self._is_ready, "is not ready")
        granted = self._ask(pipe.Arm(owner="virtual time", lease=LEASE, ts_us=0))
        self._n += 1
        request = replace(request, lease=LEASE, n=self._n)
        Ts, rig = granted.body["Ts"], (self._config, self._description)
        if isinstance(request, ControlRequest):
            plan = make_control_plan(request, request.reference, Ts, *rig)
        else:
            plan = make_plan(options_of(request), request.u, Ts, *rig)
        order, _ = self._runs.open(plan, Ts, waits=True)
        self._has_ended = False
        self._ask(order)
        self._until(lambda: self._has_ended, "does not end its run", plan.samples * Ts)
        level, text = self._runs.completion_line(_FINISH_S)
        last = self._runs.last
        if level != "info" or last is None or not last.is_complete:
            raise OperationError(text or f"the recording is not complete after {_FINISH_S:g} s")
        return Path(last.recording)

    def _is_ready(self) -> bool:
        """Return True in the phase safe, after the first sample, which arming needs."""
        return self._has_sample and self._state is not None and self._state.phase == "safe"

    def _ask(self, order: Orders) -> Answer:
        """Send an order; return its answer, or raise OperationError if the order is refused."""
        self._n += 1
        number = self._n
        self._rig.order(replace(order, order=number))
        self._until(lambda: number in self._answers, "does not answer")
        answer = self._answers.pop(number)
        if answer.code is not None:
            raise OperationError(answer.error)
        return answer

    def _until(self, condition: Callable[[], bool], failing: str, seconds: float = 0.0) -> None:
        """Let virtual time pass until `condition()` is true."""
        ports = self._rig.ports
        end_ns = ports.now + round(seconds * 1e9) + _SETTLE_NS
        while not condition():
            if ports.now >= end_ns or self._rig.loop.ended:
                raise OperationError(f"the emulated rig {failing}: {self._state}")
            self._take(self._rig.run_until(min(end_ns, ports.now + _STEP_NS)))
            self._rig.records.clear()

    def _take(self, records: list[bytes | Record]) -> None:
        batch: list[Outgoing] = []
        for record in records:
            match record:
                case bytes():
                    self._has_sample = True
                    sample = decode_sample(record)
                    if sample is not None and self._runs.includes_sample(sample.k):
                        fields = sample.t_host_ns, sample.t_sched_ns, sample.k, record
                        batch.append(Outgoing("sample", *fields))
                case RunStarted():
                    self._begin(record)
                case RunEnded():
                    late = self._thinning.due(self._rig.ports.now, end=True)
                    batch += [outgoing(line, self._offset_ns) for line in late]
                    self._runs.add(batch)
                    batch = []
                    self._runs.end(Ending(record.outcome_code, record.outcome))
                    self._has_ended = True
                case Answer():
                    self._answers[record.order] = record
                case Log() if not self._thinning.lets_through(record):
                    pass
                case Trace() | Gap() | Log() | Timing() | Clock() | State() | pipe.Control():
                    if isinstance(record, State):
                        self._state = record
                    if self._runs.includes(record):
                        batch.append(outgoing(record, self._offset_ns))
        self._runs.add(batch)

    def _begin(self, started: RunStarted) -> None:
        if self._state is None:
            raise OperationError("a run started on a rig that has reported no state")
        self._runs.begin(started, self._state, {}, self._offset_ns)


def _name(seed: int, codes: bytes) -> str:
    """Return the name of a run: a hash of the seed and the input."""
    return hashlib.blake2b(codes, key=str(seed).encode(), digest_size=4).hexdigest()


def requests_of(text: bytes) -> list[RunRequest | ControlRequest]:
    """Return the runs in `text`; each line is a command `run` or `control`, without its lease.

    A command `control` is the one with a law.

    Raises ValueError if a line is not a run; the message names the line and the error.
    """
    runs: list[RunRequest | ControlRequest] = []
    for number, line in enumerate(text.splitlines(), 1):
        try:
            fields: dict[str, Any] = msgspec.json.decode(line, type=dict[str, Any])
            fields |= {"lease": LEASE, "n": 0}
            if "law" in fields:
                runs.append(msgspec.convert(fields, ControlRequest))
            else:
                runs.append(msgspec.convert(fields, RunRequest))
        except msgspec.MsgspecError as err:
            raise InputError(f"line {number} is no run: {err}") from err
    return runs
