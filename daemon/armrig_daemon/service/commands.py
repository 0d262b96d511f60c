"""Commands of clients: the service passes them to the loop as orders, and answers them later.

The service itself refuses a command for a reason that the loop cannot know, such as a full disk.
The core decides whether an order is allowed.
"""

from __future__ import annotations

import secrets
import time
import unicodedata
from collections.abc import Callable
from typing import Any, NamedTuple, assert_never

from armrig_core.commands import commands
from armrig_core.commands.codes import RefusalCode
from armrig_core.commands.commands import CommandRefusedError
from armrig_core.errors import InputError
from armrig_core.process.printable import printable
from armrig_core.process.standstill import boot_ns
from armrig_core.rig.volts import code_of
from msgspec.structs import replace

from armrig_daemon import pipe
from armrig_daemon.config import Config
from armrig_daemon.decisions import orders
from armrig_daemon.decisions.budget import check
from armrig_daemon.decisions.state import Phase
from armrig_daemon.pipe import Alive, Answer, Calibrate, Leased, Orders, Reset
from armrig_daemon.service.admission import RUNS, Bucket, take
from armrig_daemon.service.calibration import check_calibration
from armrig_daemon.service.client_watchdog import not_newer
from armrig_daemon.service.host.child import LoopChild
from armrig_daemon.service.host.planner import Job
from armrig_daemon.service.host.worker import Worker
from armrig_daemon.service.listener import Command
from armrig_daemon.service.plan import check_voltages
from armrig_daemon.service.preparation import UNTIMED_S, Preparation
from armrig_daemon.service.publish import TOO_MANY, CommandKind, Session
from armrig_daemon.service.rig_view import RigView
from armrig_daemon.service.runs import Runs

ANSWER_S = 3.0
"""Longest time for the loop to answer a command, in s."""
_SILENT = commands.build_refusal(
    RefusalCode.NO_ANSWER,
    f"the loop did not answer within {ANSWER_S:g} s: try again, or restart armrigd",
)
_SLOW_DISK = commands.build_refusal(
    RefusalCode.NO_ROOM,
    f"the disk of the recordings did not answer within {ANSWER_S:g} s: arm again when it does, or "
    "set [recording] directory to another disk",
)
_EXPIRED = commands.build_refusal(
    RefusalCode.EXPIRED,
    "the command came too late, because its client no longer waited for the reply: send it again",
)
_NOT_HELD = commands.build_refusal(RefusalCode.NOT_HELD, orders.NOT_HELD)
_SOMEBODY = "somebody on this machine"
_MAX_COMMANDS = 16  # commands of a kind in a row; then the loop and the run's client are checked
_MAX_PENDING = 16  # unanswered orders; at this number, arm, reset and calibrate are refused
_NOTES_PER_S, _MAX_NOTES = 2, 20  # of all clients; a flood must fill neither recording nor log
_MAX_UNANSWERED = 64  # orders of all clients; more would delay the orders of the service itself
_MAX_NAME_CHARACTERS = 80
_MOST_WAITING = 4  # calls of the file system that have not returned; more would fill the memory
_KEEP_S = 0.5  # shortest time between two signs of life for the lease, in s
_SQUARE = str.maketrans("()", "[]")


class _Waiting(NamedTuple):
    command: Command
    until: float
    order: Orders
    body: Any
    """Body of the answer to the client; None to use the body of the loop's answer."""
    who: str
    """Name of the client, for the log."""


class _Holder(NamedTuple):
    """Client to which the lease was granted; no other client can use the lease."""

    owner: str
    by: str
    """Checked identity; "" on the Unix socket."""


class Commands:
    """Handler of the commands of a session."""

    def __init__(
        self,
        config: Config,
        rig: RigView,
        runs: Runs,
        session: Session,
        loop: LoopChild,
        preparation: Preparation,
        disk: Worker,
        say: Callable[..., None],
        note: Callable[[int, str, str], None],
    ) -> None:
        """Create the handler; no lease is in force.

        `preparation` prepares runs, and `disk` calls functions of the file system. `say` logs a
        line: its arguments are the level, the text, and the fields by keyword. `note` publishes and
        records a note: its arguments are the monotonic time in ns, text and owner.
        """
        self._config = config
        self._rig = rig
        self._runs = runs
        self._session = session
        self._loop = loop
        self._preparation = preparation
        self._disk = disk
        self._kept_s = 0.0  # time of the newest sign of life for the lease, on the monotonic clock
        self._arming: Command | None = None  # whose room on the disk is being checked
        self._say = say
        self._note = note
        self._notes = Bucket(_MAX_NOTES)
        self._waiting: dict[int, _Waiting] = {}
        self._calibration: tuple[int, commands.CalibrateRequest] | None = None  # not yet accepted
        self._numbers = 0
        self._Ts = config.ts_us / 1e6  # of the newest lease
        self._lease = ""
        self._holder = _Holder("", "")
        self._n = -1  # number of the newest order with this lease

    def note_lease(self, lease: str) -> None:
        """Store the lease in force; "" if no lease is in force."""
        self._lease, self._n = lease, -1
        self._session.lease = lease.encode()
        if not lease:
            self.cancel("the lease ended")

    @property
    def room(self) -> int:
        """Number of further orders that may wait for the loop's answer."""
        return max(0, _MAX_UNANSWERED - len(self._waiting))

    @property
    def is_waiting(self) -> bool:
        """True while the loop has not answered a command, or a command is prepared."""
        return bool(self._waiting or self._arming or self._preparation.is_busy)

    def serve_signs(self) -> None:
        """Handle the signs of life of the run's client, each with its time of arrival."""
        for command in self._session.waiting(CommandKind.SIGN):
            self._try(command)

    def serve(self) -> None:
        """Handle some of the waiting commands, a stop before all others."""
        for command in self._session.waiting(CommandKind.STOP, self.room):
            self._try(command)
        for command in self._session.waiting(CommandKind.LEASED, min(_MAX_COMMANDS, self.room)):
            self._try(command)
        for kind in (CommandKind.STATUS, CommandKind.CALIBRATE, CommandKind.OTHER):
            for command in self._session.waiting(kind, _MAX_COMMANDS):
                self._try(command)
        self._disk.hand_back()
        try:
            self._go_on()
        except Exception as err:  # such as too many threads
            text = f"run: {err!r}"
            self._preparation.cancel(commands.build_refusal(RefusalCode.INTERNAL, text))
            self._say("error", text)

    def _go_on(self) -> None:
        """Send the order of a prepared run if its client still waits."""
        if self._is_expired(self._preparation.valid_until_ns):
            self._preparation.cancel(_EXPIRED)
        ready = self._preparation.advance(self._check_run)
        if ready is None:
            return
        try:
            self._check_run(ready.command, ready.options, ready.valid_until_ns)
            self._order(ready.command, ready.order, ready.accepted)
        except CommandRefusedError as err:
            self._preparation.cancel(err.refusal)
        else:
            self._preparation.drop()

    def _check_run(
        self, command: Command, options: commands.RunOptions, valid_until_ns: int | None
    ) -> None:
        """Raise CommandRefusedError if the order of a run may not leave now."""
        if options.lease != self._lease:
            raise CommandRefusedError(_NOT_HELD)
        if options.n <= self._n:
            raise not_newer(options.n, self._n)
        self._check_time(command, valid_until_ns)

    def answer(self, answer: Answer) -> None:
        """Pass on an answer of the loop."""
        if self._calibration is not None and answer.order == self._calibration[0]:
            # The loop uses the calibration even if the client got a refusal because of the delay.
            (_, request), self._calibration = self._calibration, None
            if answer.code is None:
                self._note_calibration(request)
        waiting = self._waiting.pop(answer.order, None)
        if waiting is None:
            return  # too late: the client has been refused already
        if answer.code is not None:
            refusal = commands.build_refusal(answer.code, answer.error, **answer.parameters)
            self._give_up(waiting, refusal)
            return
        if isinstance(waiting.order, pipe.Arm):
            self._Ts = answer.body["Ts"]
            self.note_lease(waiting.order.lease)
            self._holder = _Holder(waiting.order.owner, waiting.command.by)
        elif isinstance(waiting.order, Leased) and waiting.order.lease == self._lease:
            self._n = max(self._n, waiting.order.n)
        now = {"now_ns": boot_ns()} if isinstance(waiting.order, pipe.Arm) else {}
        waiting.command.answer(waiting.body or answer.body | now)
        if not isinstance(waiting.order, pipe.Set):
            name, who = waiting.command.name, waiting.who or _SOMEBODY
            cause = waiting.order.reason if isinstance(waiting.order, pipe.Stop) else ""
            self._say(
                "info",
                f"{name}: by {who}",
                command=name,
                owner=who,
                owner_checked=waiting.command.by,
                cause=cause,
            )

    def refuse_overdue(self, now: float) -> None:
        """Refuse commands that the loop has not answered in time; `now` is monotonic, in s."""
        for number in [n for n, w in self._waiting.items() if now > w.until]:
            self._give_up(self._waiting.pop(number), _SILENT)
        if self._arming is not None and now > self._arming.came_s + ANSWER_S:
            command, self._arming = self._arming, None
            command.refuse(_SLOW_DISK)

    def _give_up(self, waiting: _Waiting, refusal: commands.Refused) -> None:
        if isinstance(waiting.order, pipe.Run):
            self._runs.forget(waiting.order.run_id)
        waiting.command.refuse(refusal)

    def _try(self, command: Command) -> None:
        try:
            if command.name in RUNS:
                self._prepare(command)
            else:
                self._carry_out(command, commands.parse(command.name, command.payload))
        except CommandRefusedError as err:
            command.refuse(err.refusal)
        except ValueError as err:
            command.refuse(commands.build_refusal(RefusalCode.NOT_ALLOWED, str(err)))
        except Exception as err:
            text = f"{command.name}: {err!r}"
            command.refuse(commands.build_refusal(RefusalCode.INTERNAL, text))
            self._say("error", text)

    def _carry_out(self, command: Command, request: commands.Requests) -> None:
        """Pass a request to the loop; raise ValueError if the request is not allowed."""
        if isinstance(request, commands.LeasedRequest):
            if command.by != self._holder.by:
                raise CommandRefusedError(_NOT_HELD)
            if not isinstance(request, commands.DisarmRequest):  # which may come late, as a stop
                self._check_time(command, request.valid_until_ns)
        match request:
            case commands.Status():
                command.answer(self._rig.status(self._runs.last))
            case commands.ArmRequest():
                self._arm(command, request)
            case commands.DisarmRequest():
                self._order(command, pipe.Disarm(lease=request.lease, n=request.n))
                self.cancel("the rig was disarmed")
            case commands.SetRequest():
                (volts,) = check_voltages([request.u], replace(self._config.limits, slew_v=0.0))
                code = code_of(volts)
                self._order(command, pipe.Set(lease=request.lease, n=request.n, code=code))
            case commands.SetReferenceRequest():
                order = pipe.SetReference(lease=request.lease, n=request.n, r=request.r)
                self._order(command, order)
            case commands.Renew():
                self._renew(command, request)
            case commands.StopRequest():
                who = display_name(request.by, command.by)
                halt = pipe.Stop(reason=f"stopped by {who}") if who else pipe.Stop()
                self._order(command, halt, who=who)
                self.cancel(f"stopped by {who}" if who else "stopped")
            case commands.NoteRequest():
                self._take_note(command, request)
            case commands.ResetRequest():
                self._require(command, "fault", request.fault, self._rig.state.fault)
                self._check_time(command, request.valid_until_ns)
                self._order(command, Reset())
                self.cancel("reset")
            case commands.CalibrateRequest():
                self._calibrate(command, request)
            case commands.RunRequest() | commands.ControlRequest():
                raise AssertionError  # `_prepare` has taken it
            case _:
                assert_never(request)

    def _take_note(self, command: Command, request: commands.NoteRequest) -> None:
        """Publish and record a note, which never reaches the loop and cannot affect the motor."""
        left = take(self._notes, time.monotonic(), _NOTES_PER_S, _MAX_NOTES)
        if left is None:
            text = f"too many notes, at most {_NOTES_PER_S:g} a second are accepted: try again"
            raise CommandRefusedError(
                commands.build_refusal(RefusalCode.TOO_MANY, text, per_s=_NOTES_PER_S)
            )
        self._notes = left
        who = display_name(request.owner, command.by) or _SOMEBODY
        self._note(round(command.came_s * 1e9), request.text, who)
        command.answer(commands.Done(done=self._runs.takes_notes))

    def _calibrate(self, command: Command, request: commands.CalibrateRequest) -> None:
        """Pass a calibration to the loop, without its field `made`."""
        if self._calibration is not None:
            text = "another calibration is on its way: try again"
            raise CommandRefusedError(commands.build_refusal(RefusalCode.TOO_MANY, text))
        now = self._rig.calibration_sha256
        self._require(command, "replaces", request.replaces, now)
        self._check_time(command, request.valid_until_ns)
        device = self._rig.state.device
        checked = check_calibration(
            request.calibration, request.raw, self._config, device, self._rig.description
        )
        self._order(command, Calibrate(calibration=replace(checked, made=None)))
        self._calibration = self._numbers, replace(request, calibration=checked)

    def _note_calibration(self, request: commands.CalibrateRequest) -> None:
        """Report a calibration that the loop has accepted, and record it with the next runs."""
        self._rig.note_calibration(request.calibration)
        self._runs.note_calibration(request.calibration, request.raw)
        now = self._rig.status(None)
        self._say("info", f"calibration: {now.calibration}, sha256 {now.calibration_sha256[:8]}")

    def _objection(self) -> commands.Refused | None:
        """Return the service's refusal of an arming, or None if the service permits the arming."""
        owner = self._rig.state.owner
        if owner:
            return commands.build_refusal(
                RefusalCode.HELD, orders.holder_sentence(owner), owner=owner
            )
        if line := self._rig.line:
            return commands.build_refusal(RefusalCode.NO_RIG, line)
        return self._rig.objection()

    def _arm(self, command: Command, request: commands.ArmRequest) -> None:
        """Arm the rig after a look at the disk, if the client still waits then."""
        if objection := self._objection():
            raise CommandRefusedError(objection)
        if self._arming is not None:
            raise CommandRefusedError(TOO_MANY)
        if self._disk.waiting > _MOST_WAITING:
            raise CommandRefusedError(_SLOW_DISK)
        lease, ts_us = secrets.token_hex(16), self._ts_us(request.Ts)
        owner = display_name(request.owner, command.by)
        order = pipe.Arm(owner=owner, lease=lease, ts_us=ts_us, owner_checked=command.by)

        def then(no_room: commands.Refused | Exception | None) -> None:
            if self._arming is not command:
                return  # refused meanwhile
            self._arming = None
            if isinstance(no_room, Exception):
                no_room = commands.build_refusal(RefusalCode.INTERNAL, f"arm: {no_room!r}")
            try:
                if objection := no_room or self._objection():
                    raise CommandRefusedError(objection)
                self._order(command, order, who=owner)
            except CommandRefusedError as err:
                command.refuse(err.refusal)

        self._arming = command
        self._disk.call(self._runs.no_room, then)

    def _prepare(self, command: Command) -> None:
        """Have a run planned and its file created; `_go_on` then sends its order."""
        if not self._lease or command.by != self._holder.by:
            raise CommandRefusedError(_NOT_HELD)
        if self._rig.state.phase == Phase.ACTIVE and self._runs.is_idle:
            raise CommandRefusedError(commands.build_refusal(RefusalCode.BY_HAND, orders.BY_HAND))
        config, start_rad = self._runs.config, self._rig.start_rad
        job = Job(0, command.payload, self._Ts, config, start_rad, command.name)
        self._preparation.begin(command, job)
        command.payload = b""  # of up to 80 MB

    def _renew(self, command: Command, request: commands.Renew) -> None:
        """Note a sign of life of the client of the current run, or of the run in preparation."""
        if self._preparation.is_busy and request.lease == self._lease:
            self._preparation.renew(request)
            if command.came_s >= self._kept_s + _KEEP_S:
                self._kept_s = command.came_s
                self._loop.order(Alive(lease=self._lease))  # the rig stays armed
        else:
            self._runs.renew(request, command.came_s)
        command.answer(commands.Done(done=True))

    def cancel(self, why: str) -> None:
        """Refuse the run in preparation, if there is one."""
        text = f"the run did not begin: {why}"
        self._preparation.cancel(commands.build_refusal(RefusalCode.CANCELLED, text))

    def _check_time(self, command: Command, valid_until_ns: int | None) -> None:
        """Raise CommandRefusedError if the client of a command has given up."""
        if valid_until_ns is None and command.by:
            text = f"{command.name}: valid_until_ns is missing: install a newer armrig"
            raise CommandRefusedError(commands.build_refusal(RefusalCode.EXPIRED, text))
        late_s = time.monotonic() - command.came_s - UNTIMED_S if valid_until_ns is None else 0.0
        if late_s > 0 or self._is_expired(valid_until_ns):
            raise CommandRefusedError(_EXPIRED)

    def _is_expired(self, valid_until_ns: int | None) -> bool:
        return valid_until_ns is not None and boot_ns() > valid_until_ns

    def _require(self, command: Command, field: str, named: str | None, now: str) -> None:
        """Raise CommandRefusedError if a command names another fault or calibration than now."""
        if named is None and command.by:
            text = f"{command.name}: {field} is missing: install a newer armrig"
        elif named is not None and named != now:
            text = f"{command.name}: {field} is '{printable(named[:64])}', and it is now '{now}'"
            text += ": look at `armrig status`, then repeat the command"
        else:
            return
        raise CommandRefusedError(commands.build_refusal(RefusalCode.EXPIRED, text))

    def _ts_us(self, Ts: float | None) -> int:
        """Return the requested sampling time, in µs; 0 for the configured sampling time."""
        if Ts is None:
            return 0
        if round(Ts * 1e6, 3) % 1:
            raise InputError(f"Ts={Ts} must be a whole number of microseconds")
        device = self._config.device
        check(round(Ts * 1e6), device.baud, scheduled=True, oversampling=device.oversampling)
        return round(Ts * 1e6)

    def _order(
        self, command: Command, order: Orders, body: Any = None, who: str | None = None
    ) -> None:
        """Send an order to the loop; the loop's answer becomes the answer to the command."""
        if who is None:
            who = self._holder.owner if isinstance(order, Leased) else display_name("", command.by)
        if len(self._waiting) >= _MAX_PENDING and isinstance(order, pipe.Arm | Reset | Calibrate):
            raise CommandRefusedError(TOO_MANY)
        self._numbers += 1
        order = replace(order, order=self._numbers)
        until = time.monotonic() + ANSWER_S
        self._waiting[self._numbers] = _Waiting(command, until, order, body, who)
        self._loop.order(order)


def display_name(claim: str, by: str) -> str:
    """Return a client's name for people; the daemon has checked the part in round brackets.

    Programs read the checked identity from `owner_checked` in the status, the log and the manifest.

    `claim` is the name that the client gives; round brackets in it become square brackets. `by` is
    the checked identity, such as `certificate alice`; "" on the Unix socket, where the daemon
    trusts every client that may open the socket.
    """
    begin = claim.strip()[:_MAX_NAME_CHARACTERS]  # the rest of a very long name would delay a stop
    name = "".join(map(_square, printable(begin).strip()[:_MAX_NAME_CHARACTERS]))
    if not by:
        return name
    return f"{name} ({by})" if name else by


def _square(character: str) -> str:
    """Return a square bracket for a round bracket and for characters that look like a bracket."""
    plain = unicodedata.normalize("NFKC", character)
    if "(" in plain or ")" in plain:
        return plain.translate(_SQUARE)
    if character in "[]{}":
        return character
    return {"Ps": "[", "Pe": "]"}.get(unicodedata.category(character), character)
