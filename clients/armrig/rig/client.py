"""Client of a rig's daemon: it sends queries and commands, and receives messages."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, suppress
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self, TypeVar

import msgspec
import zenoh
from armrig_core.access.daemon_lock import living_daemon
from armrig_core.access.endpoint import network_address
from armrig_core.commands import commands
from armrig_core.errors import InputError, MalformedReplyError
from armrig_core.process.printable import plural, printable
from armrig_core.process.standstill import Standstill, boot_ns
from armrig_core.rig.calibration_file import raw_samples, read_calibration
from armrig_core.rig.volts import U_MAX_V
from armrig_core.telemetry import topics
from msgspec.structs import replace

from armrig.rig.replies import (
    BusyError,
    Progress,
    RefusedError,
    complete_recording,
    refusal_error,
    refusal_of,
    reply_of,
    this_user,
)
from armrig.rig.session import (
    LostLinkError,
    NoReplyError,
    RigError,
    ServiceStoppedError,
    client_endpoint,
    no_daemon,
    no_reply,
    not_permitted,
    open_connection,
    service_has_stopped,
)

if TYPE_CHECKING:  # a stop waits for all imports of this module
    import numpy as np
    from armrig_core.control.control_law import ControlLaw
    from armrig_core.rig.description import Input
    from numpy.typing import ArrayLike, NDArray

    from armrig.rig.control_loop import ControlLoop

REPLY_S = 5.0  # longest wait for a reply
_SAMPLE_S, _REMOTE_SAMPLE_S = 5e-6, 2e-5  # time to send a sample: 20 B, over a network 1 MB/s
_SIGN_S = 1.0  # between two signs of life while a run is rehearsed
_PREPARATION_S = 120.0  # longest wait for the beginning of a run: the daemon plans for up to 60 s
_POLL_INTERVAL_S = 0.1
_REPEAT_INTERVAL_S = 0.02  # between two attempts of a temporarily refused command
# Time for which a temporarily refused command is repeated. The daemon reports its timing once a
# second. A stall can spoil two reports; the third report is good again.
_REPEAT_S = 2.5
_SHORT_S = 0.01  # sampling time that no description forbids
_ROUNDING_V = 1e-9  # largest error of a value's voltage
_R = TypeVar("_R")
_TIMEOUT = b"Timeout"  # an error of zenoh; the daemon's own errors are JSON


class Rig:
    """Client of one rig's daemon; use it in a `with` block.

    If the daemon temporarily refuses `status`, `arm`, `note`, `reset` or `calibrate`, the client
    repeats the command for up to 2.5 s.

    Parameters
    ----------
    rig : str, default "1"
        Id of the rig.
    connect : str, optional
        Endpoint of the daemon. The default is the endpoint in `[client]` of the configuration. If
        there is no endpoint in `[client]`, the client tries two sockets: first the socket of this
        user's daemon, then the socket of this machine's service.
    certificate : str or Path, optional
        Credential for an endpoint such as tls/lab-1.local:7447; by default the credential in
        `[client]`.

    Raises
    ------
    NoReplyError
        No daemon answers at the start of the block, or the daemon refuses the client.
    RigError
        Another user owns the socket's directory or may write to it, or the credential cannot be
        used.
    ValueError
        The id is not valid.

    Examples
    --------
    The example starts an emulated rig. The examples of the methods need a running rig, such as the
    emulated rig of `armrig lab`.

    >>> from pathlib import Path
    >>> from armrig.rig.local_daemon import running
    >>> with running(["--emulate"], rig="1", log=Path("log")):
    ...     with armrig.Rig("1") as rig:
    ...         granted = rig.arm("a student", Ts=0.01)
    ...         path = rig.run(armrig.step(50, at=20))
    >>> armrig.load(path).N
    50
    """

    def __init__(
        self,
        rig: str = "1",
        *,
        connect: str | None = None,
        certificate: str | Path | None = None,
    ) -> None:
        self.rig = topics.check_rig_id(rig)
        self.endpoint = connect or client_endpoint(rig)
        self._connect = connect
        self._certificate = certificate
        self._name = ""  # name in the certificate, which the keys of commands contain
        self._session: zenoh.Session | None = None
        self._lease = ""
        self._owner = ""
        self._n = 0
        self._ahead_ns: int | None = None  # clock of the daemon minus that of this computer
        self._limits_v, self._rest_v = (0.0, U_MAX_V), 0.0
        self._input: Input | None = None
        self.every = 1
        """Number of samples of the device in a sampling time, since `arm`."""
        self.last_run: commands.LastRun | None = None
        """Daemon's report on the last run that `run` played."""

    def __enter__(self) -> Self:
        """Connect."""
        self._session, self.endpoint, self._name = open_connection(
            self._connect, rig=self.rig, certificate=self._certificate
        )
        return self

    def __exit__(self, *_: object) -> None:
        """Release the rig if this client has the lease, and disconnect."""
        if self._session is None:
            return
        try:
            if self._lease:
                # If the lease or the daemon is gone, there is nothing to release.
                with suppress(RigError):
                    self.disarm()
        finally:
            self._session.close()
            self._session = None

    def status(self) -> commands.StatusReport:
        """Return the daemon's status.

        Examples
        --------
        >>> with armrig.Rig("1") as rig:
        ...     granted = rig.arm("a student")
        ...     status = rig.status()
        >>> status.phase, status.owner, status.u_max
        ('armed', 'a student', 5.0)
        """
        return self._ask_again(commands.Status(), commands.StatusReport)

    def arm(self, owner: str, Ts: float | None = None) -> commands.LeaseGranted:
        """Take the lease of the rig; the motor stays at 0 V.

        Parameters
        ----------
        owner : str
            Name of the owner, which other users see; 1 to 80 characters.
        Ts : float, optional
            Sampling time in s, at most 60; by default the configured sampling time. Above 1 s, or
            a fifth of the description's `blind_s`, `run` plays each voltage in several samples.
            The recording contains all samples; its datasets contain the instants of Ts.

        Returns
        -------
        LeaseGranted
            Sampling time `Ts`, in s, and lowest and highest allowed voltage, `u_min` and `u_max`,
            in V.

        Raises
        ------
        RefusedError
            Another client has the lease, the rig is in a fault, or `Ts` is not possible. The
            exception is a `BusyError` if the rig or its host was not ready within 2.5 s.
        NoReplyError
            The daemon does not answer.

        Examples
        --------
        >>> with armrig.Rig("1") as rig:
        ...     granted = rig.arm("a student", Ts=0.005)
        >>> granted.Ts, granted.u_min, granted.u_max
        (0.005, 0.0, 5.0)
        """
        every = 1
        if Ts is not None and Ts > _SHORT_S:
            every = commands.samples_of(Ts, self.status().described.longest_sample_s)
        asked = commands.ArmRequest(owner=owner, Ts=None if Ts is None else Ts / every)
        granted = self._ask_again(asked, commands.LeaseGranted)
        self._lease, self._n, self._owner, self.every = granted.lease, 0, owner, every
        # The reply came after the daemon read its clock: an order is rather refused than late.
        self._ahead_ns = granted.now_ns - boot_ns() if granted.now_ns else None
        self._limits_v, self._rest_v = (granted.u_min, granted.u_max), granted.rest_v
        self._input = None
        return msgspec.structs.replace(granted, Ts=every * granted.Ts)

    def run(
        self,
        u: ArrayLike | None = None,
        *,
        pacing: Literal["scheduled", "exchange"] = "scheduled",
        experiment: str = "run",
        details: Mapping[str, Any] | None = None,
        dead_man: float | None = None,
        accepted: Callable[[commands.RunAccepted], None] | None = None,
        progress: Progress | None = None,
        tell: Callable[[str], None] | None = None,
        **values: ArrayLike,
    ) -> Path:
        """Play `u`, wait until the run is recorded, and return the recording's path.

        Every exception during the wait, including Ctrl-C, stops the rig. The lease ends with the
        run: call `arm` again before the next run.

        Parameters
        ----------
        u : array_like, shape (N,), optional
            Voltage at the pin at each sample, in V, inside the limits that `arm` returned. N is at
            least 1 and at most 4 000 000.
        pacing : {"scheduled", "exchange"}
            Clock that triggers each sample: the device's timer ("scheduled"), or the host
            ("exchange"). With "exchange", the data contain the jitter of the host.
        experiment : str, default "run"
            Kind of experiment, part of the recording's name; allowed are a-z, 0-9 and -.
        details : mapping, optional
            Settings of the experiment, such as its seed; the recording contains them. The name
            "every" is that of the samples with each voltage, for a Ts above 1 s.
        dead_man : float, optional
            Time in s, 0.5 to 60. If this process sends no sign of life for this time, the daemon
            stops the run, because the process may have been killed, frozen or disconnected. By
            default the run continues even if this process ends. A sign of life is sent after each
            call of `progress`. If `progress` takes longer than `dead_man`, the run therefore ends.
        accepted : callable, optional
            Called once with the daemon's answer when the run begins. The answer's `rehearsal`
            contains the prediction of the rig's model.
        progress : callable, optional
            Called about ten times a second with two arguments: the number of samples taken so far,
            and the number of samples of the run.
        tell : callable, optional
            Called with a sentence if this computer slept, if a run with a `dead_man` loses its
            link, and when the rig answers again. Until the dead-man's time is over, the client
            tries to reach the rig.

        **values : array_like, shape (N,)
            Values of the input in its own unit, by its name instead of u, as for `set`.

        Returns
        -------
        Path
            Path of the recording. The file is complete and synchronised on the daemon's disk, and
            therefore survives a loss of power. `last_run.samples` is the number of samples.

        Raises
        ------
        RunEndedError
            The run ended before its last sample; the recording contains the samples until then.
        LostLinkError
            The link was lost and did not return within `dead_man`.
        RefusedError
            The rig is not armed, a value is not allowed, or the rehearsal exceeds the limits.
        ValueError
            `u` does not have the shape (N,), or a voltage is not allowed or not a number. Nothing
            was sent.

        Examples
        --------
        >>> u = armrig.telegraph(50, 0.1, seed=1)
        >>> with armrig.Rig("1") as rig:
        ...     granted = rig.arm("a student", Ts=0.01)
        ...     path = rig.run(u, experiment="blackbox", details={"seed": 1})
        >>> rig.last_run.outcome, rig.last_run.samples
        ('complete', 50)
        >>> abs(armrig.load(path).u - u).max() < 0.005  # a step of the motor's driver
        np.True_
        """
        if commands.EVERY in (details or {}):
            raise InputError(f"details: {commands.EVERY!r} is the name of the samples per voltage")
        made = {commands.EVERY: self.every} if self.every > 1 else {}
        voltage = self._volts(u, values).repeat(self.every)
        request = commands.RunRequest(
            **self._stamp(REPLY_S + self._sending_s(voltage.size)),
            u=voltage.tolist(),
            pacing=pacing,
            experiment=experiment,
            details=dict(details or {}) | made,
            dead_man=dead_man,
        )
        return self._play(request, voltage.size, accepted, progress, tell)

    def control(
        self,
        law: ControlLaw,
        reference: ArrayLike,
        *,
        dead_man: float = 1.0,
        unstable: bool = False,
        unmonitored: bool = False,
        experiment: str = "control",
        details: Mapping[str, Any] | None = None,
        accepted: Callable[[commands.RunAccepted], None] | None = None,
        progress: Progress | None = None,
        tell: Callable[[str], None] | None = None,
    ) -> Path:
        """Control the rig by a law, wait until the run is recorded, and return its path.

        The daemon rehearses the closed loop on the rig's model, and evaluates the law at each
        sample. A run that ends early by a bound of the law leaves no fault. Every exception during
        the wait, including Ctrl-C, stops the rig. The lease ends with the run.

        Parameters
        ----------
        law : ControlLaw
            Law, such as of `armrig.control.control_law`. Its Ts must be that of `arm`.
        reference : array_like, shape (N,)
            Reference at each sample, in the unit of the law and inside its range.
        dead_man : float, default 1
            Time in s, 0.5 to 60. If this process sends no sign of life for this time, the daemon
            stops the run.
        unstable : bool, default False
            True to allow a closed loop whose rehearsal is unstable; the limits of the outputs hold.
        unmonitored : bool, default False
            True to allow a law without a monitor. A stuck sensor then drives the rig to full input.
        experiment, details, accepted, progress, tell : optional
            As for `run`.

        Returns
        -------
        Path
            Path of the recording, with the law and the reference.

        Raises
        ------
        RunEndedError
            The run ended before its last sample.
        RefusedError
            The rig is not armed, or law, reference or rehearsal are not allowed.
        ValueError
            A value of the reference is not allowed. Nothing was sent.

        Examples
        --------
        A law that adds nothing to a voltage of r volts:

        >>> from armrig_core.control.control_law import LawOutput, Reference
        >>> law = armrig.control.ControlLaw(
        ...     Ts_us=10_000, outputs=(LawOutput(name="alpha", unit="rad"),),
        ...     reference=Reference(name="u", unit="V", low=0, high=5),
        ...     A=(), B=(), C=(), D=1.0, x0=(), F=((),),
        ... )
        >>> with armrig.Rig("1") as rig:
        ...     granted = rig.arm("a student", Ts=0.01)
        ...     path = rig.control(law, [1.0, 2.0, 3.0], unmonitored=True)
        >>> armrig.load(path).u.round(1)
        array([1., 2., 3.])
        """
        import numpy as np

        r = np.asarray(reference, dtype=np.float64)
        if r.ndim != 1 or r.size == 0:
            raise InputError(f"reference has shape {r.shape}, it must be (N,) with N >= 1")
        law.check_reference(r.tolist())
        request = commands.ControlRequest(
            **self._stamp(REPLY_S + self._sending_s(r.size)),
            law=law,
            reference=r.tolist(),
            unstable=unstable,
            unmonitored=unmonitored,
            experiment=experiment,
            details=dict(details or {}),
            dead_man=dead_man,
        )
        return self._play(request, r.size, accepted, progress, tell)

    def control_loop(self, Ts: float, seconds: float, *, reference: ArrayLike = 0.0) -> ControlLoop:
        """Control the rig by a program of one's own: iterate, and set a voltage at each sample.

        The iteration arms the rig and begins a recorded run. A voltage is held until the next
        `set`, for at most the longer of 100 ms and 5 Ts; then the run ends at rest. It also ends at
        rest if the caller leaves the loop, or sets a voltage that is not allowed.

        Parameters
        ----------
        Ts : float
            Sampling time in s, at least 0.02.
        seconds : float
            Length of the run, in s.
        reference : array_like, shape () or (N,), default 0
            Reference at each of the N = seconds / Ts samples; the recording contains it.

        Returns
        -------
        ControlLoop
            Iterator over a `LoopSample` at a time. Its `missed` is the number of missed deadlines.

        Raises
        ------
        RunEndedError
            The run ended before its last sample.
        ValueError
            Ts, the reference or a voltage is not allowed.

        Examples
        --------
        >>> with armrig.Rig("1") as rig:
        ...     loop = rig.control_loop(Ts=0.1, seconds=2.0, reference=2.0)
        ...     for y in loop:
        ...         y.set(y.r)
        >>> armrig.load(loop.recording).N
        20
        """
        import numpy as np

        from armrig.rig.control_loop import SHORTEST_TS, ControlLoop

        longest_s = self.status().described.longest_sample_s
        if not SHORTEST_TS <= Ts <= longest_s:
            raise InputError(
                f"Ts = {Ts:g} s: a program of one's own controls with Ts from {SHORTEST_TS:g} to "
                f"{longest_s:g} s; for a shorter Ts, use a control law (Rig.control)"
            )
        r, N = np.asarray(reference, dtype=np.float64), round(seconds / Ts)
        if N < 2 or r.shape not in ((), (N,)) or not np.isfinite(r).all():
            raise InputError(
                f"reference has shape {r.shape}: a finite number is needed, or one for each of the "
                f"{N} samples, which must be at least 2"
            )
        values = np.broadcast_to(r, N).tolist()

        def begin() -> Callable[[], commands.LastRun]:
            self.arm(this_user() or "armrig", Ts)
            stamp = self._stamp(REPLY_S + self._sending_s(N))
            request = commands.ControlRequest(**stamp, reference=values)
            run = self._wait_for_beginning(request, N)

            def end() -> commands.LastRun:
                self._lease = ""
                options = commands.RunOptions(**stamp)  # `set` has its own dead-man: the lease
                self.last_run = self._wait_for_end(options, N, run, lambda *_: None, lambda _: None)
                return self.last_run

            return end

        return ControlLoop(self, values, begin)

    def _play(
        self,
        request: commands.RunRequest | commands.ControlRequest,
        samples: int,
        accepted: Callable[[commands.RunAccepted], None] | None,
        progress: Progress | None,
        tell: Callable[[str], None] | None,
    ) -> Path:
        """Send a run, wait until it is recorded, and return its path; stop the rig at an error."""
        run = None
        try:
            run = self._wait_for_beginning(request, samples)
            if accepted is not None:
                accepted(run)
            progress, tell = progress or (lambda done, total: None), tell or (lambda sentence: None)
            last = self._wait_for_end(request, samples, run, progress, tell)
            self.last_run = last
        except BaseException as err:
            if run is None and isinstance(err, RefusedError):
                raise  # no run began
            self._lease = ""
            with suppress(RigError):
                self.stop()
            raise
        self._lease = ""
        return complete_recording(last, samples)

    def _wait_for_beginning(
        self, request: commands.RunOptions, samples: int
    ) -> commands.RunAccepted:
        """Send a run, and wait until it begins; the daemon gets a sign of life each second."""
        (key, payload), replies = self._query(request), _Replies()
        self._require_session().get(
            key,
            handler=replies.handler,
            payload=payload,
            encoding="application/json",
            timeout=_PREPARATION_S,
        )
        ends_s = time.monotonic() + _PREPARATION_S
        sign_s = _SIGN_S + self._sending_s(samples)
        while (reply := replies.wait(sign_s)) is None:
            sign_s = _SIGN_S
            stamp = self._stamp(min(REPLY_S, ends_s - time.monotonic()))
            with suppress(RefusedError):  # the run has just begun
                self._ask(commands.Renew(**stamp), commands.Done)
        return self._read(request.name, reply, commands.RunAccepted)

    def _sending_s(self, samples: int) -> float:
        """Return the time to wait for a run on its way, during which nothing else may arrive."""
        return samples * (_REMOTE_SAMPLE_S if self._name else _SAMPLE_S)

    def _wait_for_end(
        self,
        request: commands.RunOptions,
        samples: int,
        run: commands.RunAccepted,
        progress: Progress,
        tell: Callable[[str], None],
    ) -> commands.LastRun:
        done, until_s = 0, time.monotonic() + (request.dead_man or 0.0)
        while True:
            wait_s = _REPEAT_INTERVAL_S
            # If other clients send many commands, the daemon may refuse this request. The run
            # continues. The next sign of life must not wait, so each request is sent only once.
            with suppress(BusyError):
                message = (
                    f"rig {self.rig}: link lost after {done} or more of {plural(samples, 'sample')}"
                )
                status = self._status_over_link(message, until_s, tell)
                wait_s = _POLL_INTERVAL_S
                last = status.last_run
                if last is None or last.run_id != run.run_id:
                    if service_has_stopped(self.rig, self.endpoint):
                        raise ServiceStoppedError(self.rig)
                    raise RigError(
                        f"the daemon does not know the run {run.run_id} any more: it was "
                        "restarted during the run; `armrig ls` shows what it had recorded"
                    )
                # A complete run may have missing samples: `last.samples` may be less than `total`.
                done = samples if last.is_complete else last.samples
                progress(done, samples)
                if last.finished and status.phase != "active":
                    return last
            if request.dead_man is not None:
                # This loop sends the sign of life; a thread would send it even if the client hung.
                # Refused: the run has just ended. Without an answer, the status has none either.
                with suppress(RefusedError, NoReplyError):
                    self._ask(commands.Renew(**self._stamp()), commands.Done)
                until_s = time.monotonic() + request.dead_man
            sleep = Standstill()
            time.sleep(wait_s)
            if slept := sleep.look():
                tell(slept)
                if request.dead_man is not None:  # the sleep may have closed the link
                    until_s = max(until_s, time.monotonic() + REPLY_S)

    def _status_over_link(
        self, lost: str, until_s: float, tell: Callable[[str], None]
    ) -> commands.StatusReport:
        """Return the status; wait for a lost link, if it can return, at most until `until_s`."""
        until = ""
        while True:
            try:
                status = self._ask(commands.Status(), commands.StatusReport)
            except NoReplyError as err:
                left_s = until_s - time.monotonic()
                may_return = network_address(self.endpoint) or living_daemon(self.endpoint)
                if not until and (left_s < 0 or not may_return):
                    raise
                if left_s < 0:
                    raise LostLinkError(
                        f"{lost}, and did not return; by its dead-man the rig stopped the motor at "
                        f"{until} at the latest; `armrig ls` on its machine lists the recording"
                    ) from err
                if not until:
                    until = time.strftime("%H:%M:%S", time.localtime(time.time() + left_s))
                    tell(f"{lost}; the motor may turn until {until} ({left_s:.0f} s); trying again")
            else:
                if until:
                    tell(f"rig {self.rig} answers again: waiting for the end of the run")
                return status
            time.sleep(_POLL_INTERVAL_S)

    def set(self, u: float | None = None, **values: float) -> None:
        """Hold a voltage until the next `set`, for at most the time `period_s` that `arm` returned.

        Parameters
        ----------
        u : float, optional
            Voltage at the pin in V, inside the limits that `arm` returned.
        **values : float
            Value of the input in its own unit, by its name in the rig's description instead of u:
            ``rig.set(power=60)``. A rig whose rest is not 0 V takes only this value.

        Raises
        ------
        RefusedError
            The rig is not armed, or another client has the lease.
        ValueError
            The voltage is not allowed or not a number; nothing was sent.

        Examples
        --------
        >>> with armrig.Rig("1") as rig:
        ...     granted = rig.arm("a student")
        ...     for sample in rig.stream():
        ...         rig.set(2.0)  # again within granted.period_s
        ...         if sample.u_applied_v > 0:
        ...             break
        >>> print(f"{sample.u_applied_v:.1f} V")
        2.0 V
        """
        voltages = None if u is None else [u]
        (volts,) = self._volts(voltages, {name: [value] for name, value in values.items()})
        self._ask(commands.SetRequest(**self._stamp(), u=float(volts)), commands.Done)

    def set_reference(self, r: float) -> None:
        """Let the current run under a law follow another reference from the next sample on.

        Call it in `progress` of `control`. The recording contains r at each sample, and the number
        of the command that set it.

        Parameters
        ----------
        r : float
            Reference in the unit of the law, between the least and the largest value of the
            reference with which the run began: the daemon has rehearsed these.

        Raises
        ------
        RefusedError
            No law controls the rig, r is outside the range, or another client has the lease.

        Examples
        --------
        >>> from armrig_core.control.control_law import LawOutput, Reference
        >>> law = armrig.control.ControlLaw(
        ...     Ts_us=10_000, outputs=(LawOutput(name="alpha", unit="rad"),),
        ...     reference=Reference(name="u", unit="V", low=0, high=5),
        ...     A=(), B=(), C=(), D=1.0, x0=(), F=((),),
        ... )
        >>> def progress(done: int, total: int) -> None:
        ...     if 20 < done < total:
        ...         rig.set_reference(1.0)
        >>> with armrig.Rig("1") as rig:
        ...     granted = rig.arm("a student", Ts=0.01)
        ...     path = rig.control(law, [1.0] + [3.0] * 99, progress=progress, unmonitored=True)
        >>> armrig.load(path).r[[1, -1]]
        array([3., 1.])
        """
        self._ask(commands.SetReferenceRequest(**self._stamp(), r=float(r)), commands.Done)

    def stop(self, by: str = "") -> None:
        """Set the motor to 0 V and end every run; no lease is needed.

        Parameters
        ----------
        by : str, optional
            Name of the person or program that stops the rig, stored in the recording. The default
            is the owner given to `arm`; without a call of `arm`, the login name of this user.

        Raises
        ------
        NoReplyError
            The daemon does not answer. A device that has lost its daemon stops the motor by itself.
        RigError
            The answer does not confirm the stop: pull the motor's plug.

        Examples
        --------
        >>> with armrig.Rig("1") as rig:
        ...     granted = rig.arm("a student")
        ...     rig.stop()
        ...     status = rig.status()
        >>> status.phase, status.owner
        ('safe', '')
        """
        who = by or self._owner or this_user()
        try:
            reply = self._ask(commands.StopRequest(by=who), commands.Done)
        except (RefusedError, InputError):
            # A name must not prevent a stop, for example if it is too long or no Unicode.
            reply = self._ask(commands.StopRequest(), commands.Done)
        if not reply.done:
            raise no_daemon(
                self.rig, self.endpoint, "the answer to 'stop' does not confirm the stop"
            )

    def note(self, text: str, owner: str = "") -> bool:
        """Write a note into the current run's recording; no lease is needed.

        Parameters
        ----------
        text : str
            Text, such as "touched the arm"; 1 to 500 printable characters.
        owner : str, optional
            Author; by default the owner given to `arm`, or, without a call of `arm`, the login
            name of this user.

        Returns
        -------
        bool
            True if a recording is in progress and contains the note.

        Raises
        ------
        BusyError
            There are too many notes.
        NoReplyError
            The daemon does not answer.
        ValueError
            The text is not allowed; nothing was sent.

        Examples
        --------
        >>> with armrig.Rig("1") as rig:
        ...     granted = rig.arm("a student")
        ...     path = rig.run(armrig.step(50), accepted=lambda run: rig.note("the lamp is on"))
        >>> [note.text for note in armrig.load(path).notes]
        ['the lamp is on']
        """
        commands.check_note(text)  # a network drops a long message without an answer
        request = commands.NoteRequest(text=text, owner=(owner or self._owner or this_user())[:80])
        return self._ask_again(request, commands.Done).done

    def reset(self) -> bool:
        """Clear a latched fault; the rig is then disarmed. Return True if there was a fault.

        Examples
        --------
        >>> with armrig.Rig("1") as rig:
        ...     was_in_fault = rig.reset()
        >>> was_in_fault
        False
        """
        status = self.status()
        request = commands.ResetRequest()
        if status.now_ns:
            until_ns = status.now_ns + round(REPLY_S * 1e9)
            request = commands.ResetRequest(fault=status.fault, valid_until_ns=until_ns)
        return self._ask_again(request, commands.Done).done

    def calibrate(self, path: str | Path) -> None:
        """Make the daemon use a calibration from a TOML file until the daemon ends.

        The daemon accepts a calibration only in the phase `safe`, and applies it from the next
        sample on.

        Parameters
        ----------
        path : str or Path
            Path of the file that `armrig calibrate` wrote. The samples from which the calibration
            was estimated must be in the same folder.

        Raises
        ------
        FileError
            The file contains no calibration; this exception is a ValueError.
        RefusedError
            A client has the lease, the rig is in a fault, or the calibration is of another rig.

        Examples
        --------
        The daemon accepts the file of `armrig calibrate`, and refuses a file without measurements.

        >>> import pathlib
        >>> _ = pathlib.Path("mine.toml").write_text("alpha = {zero_counts = 32800.0}")
        >>> with armrig.Rig("1") as rig:
        ...     try:
        ...         rig.calibrate("mine.toml")
        ...     except armrig.RigError as err:
        ...         print(err)
        the calibration does not say how it was made; `armrig calibrate` makes one
        """
        calibration = read_calibration(Path(path))
        status = self.status()
        request = commands.CalibrateRequest(calibration=calibration, raw=raw_samples(calibration))
        if status.now_ns:
            until_ns = status.now_ns + round(REPLY_S * 1e9)
            replaces = status.calibration_sha256
            request = replace(request, replaces=replaces, valid_until_ns=until_ns)
        self._ask_again(request, commands.Done)

    def disarm(self) -> None:
        """Release the lease of the rig; the motor is then at 0 V.

        Examples
        --------
        >>> with armrig.Rig("1") as rig:
        ...     granted = rig.arm("a student")
        ...     rig.disarm()
        ...     status = rig.status()
        >>> status.phase, status.owner
        ('safe', '')
        """
        stamp = self._stamp()
        self._lease = ""
        self._ask(commands.DisarmRequest(**stamp), commands.Done)

    def stream(self, name: str = "sample") -> Iterator[Any]:
        """Iterate over the messages that the rig publishes after this call: see `armrig.stream`.

        Examples
        --------
        >>> with armrig.Rig("1") as rig:
        ...     samples = rig.stream()
        ...     first, second = next(samples), next(samples)
        >>> second.k - first.k
        1
        """
        from armrig.rig.telemetry_stream import listen

        return listen(self._require_session(), topics.stream_key(self.rig, name), self.endpoint)

    def arrivals(self, name: str) -> AbstractContextManager[Callable[[], list[Any]]]:
        """Yield, for a `with` block, a function that returns the messages since its last call.

        Examples
        --------
        >>> import time
        >>> with armrig.Rig("1") as rig:
        ...     with rig.arrivals("sample") as new_samples:
        ...         while not (samples := new_samples()):
        ...             time.sleep(0.1)
        >>> samples[0].u_applied_v
        0.0
        """
        from armrig.rig.telemetry_stream import arrivals

        return arrivals(self._require_session(), topics.stream_key(self.rig, name))

    def _volts(self, u: ArrayLike | None, values: Mapping[str, ArrayLike]) -> NDArray[np.float64]:
        """Return the voltages (N,), of u or of the input's own values by its name.

        Raises ValueError if a voltage is outside the limits, or the values have a wrong name.
        """
        import numpy as np

        if values or self._rest_v:
            self._input = port = self._input or self.status().described.input
            if u is not None or [*values] != [port.name]:
                raise InputError(self._wrongly_named(u, values, port))
            volts = port.volts(np.asarray(values[port.name], dtype=np.float64))
            # The conversion may have a rounding error at a limit.
            for limit in self._limits_v:
                volts = np.where(np.abs(volts - limit) < _ROUNDING_V, limit, volts)
        else:
            volts = np.asarray(u, dtype=np.float64)
        if volts.ndim != 1 or volts.size == 0:
            raise InputError(
                f"u has shape {volts.shape}, it must be (N,) with N >= 1: one voltage per sample"
            )
        lowest, highest = self._limits_v
        outside = ~((volts >= lowest) & (volts <= highest))  # NaN is outside, too
        if outside.any():
            k = int(np.argmax(outside))
            raise InputError(
                f"u[{k}] = {volts[k]:g} V is outside {lowest:g} … {highest:g} V, the limits of rig "
                f"{self.rig}; a voltage outside 0 … {U_MAX_V:g} V destroys it"
            )
        return volts

    def _wrongly_named(
        self, u: ArrayLike | None, names: Mapping[str, ArrayLike], port: Input
    ) -> str:
        """Return what is wrong with values that are not those of the input by its name."""
        text = f"{port.name}={port.value(port.rest_v):g}"
        if names:
            both = "u and " * (u is not None)
            return (
                f"{both}{', '.join(names)}: the input of rig {self.rig} is {port.name}: give {text}"
            )
        return (
            f"a number without a name is a voltage at the pin, and rig {self.rig} rests at "
            f"{port.rest_v:g} V: give the value in {port.unit}, such as {text} for rest"
        )

    def _stamp(self, wait_s: float = REPLY_S) -> dict[str, Any]:
        """Return lease, number and time of validity of a command that waits `wait_s` seconds."""
        if not self._lease:
            raise RefusedError(f"rig {self.rig} is not armed by this client: call arm(owner) first")
        self._n += 1
        stamp: dict[str, Any] = {"lease": self._lease, "n": self._n}
        if self._ahead_ns is not None:
            stamp["valid_until_ns"] = boot_ns() + self._ahead_ns + round(wait_s * 1e9)
        return stamp

    def _require_session(self) -> zenoh.Session:
        if self._session is None:
            raise RigError('a Rig is used in a with block: with armrig.Rig("1") as rig: …')
        return self._session

    def _ask_again(self, request: commands.DaemonRequest, answer: type[_R]) -> _R:
        """Send a command; if it is refused temporarily, repeat it for up to `_REPEAT_S`."""
        until = time.monotonic() + _REPEAT_S
        while True:
            try:
                return self._ask(request, answer)
            except BusyError:
                if time.monotonic() > until:
                    raise
            time.sleep(_REPEAT_INTERVAL_S)

    def _ask(self, request: commands.DaemonRequest, answer: type[_R]) -> _R:
        key, payload = self._query(request)
        replies = self._require_session().get(
            key, payload=payload, encoding="application/json", timeout=REPLY_S
        )
        return self._read(request.name, replies, answer)

    def _query(self, request: commands.DaemonRequest) -> tuple[str, bytes]:
        """Return the key and the payload of a command."""
        key = topics.command_key(self.rig, request.name, self._name)
        payload = _encode(request)
        if self._name and len(payload) > commands.MOST_REMOTE_BYTES:
            raise RigError(
                f"the command {request.name} has {len(payload)} B; over a network at most "
                f"{commands.MOST_REMOTE_BYTES} B are allowed: play the input in parts, or on the "
                "rig's own machine"
            )
        return key, payload

    def _read(self, name: str, replies: Iterable[zenoh.Reply], answer: type[_R]) -> _R:
        """Return the answer in the replies to a command."""
        try:
            for reply in replies:
                if reply.ok is not None:
                    return reply_of(name, reply.ok.payload.to_bytes(), answer)
                if reply.err is None or (error := reply.err.payload.to_bytes()) == _TIMEOUT:
                    continue
                raise refusal_error(refusal_of(name, error))
        except MalformedReplyError as err:
            raise no_daemon(self.rig, self.endpoint, str(err)) from err
        if self._name:
            raise not_permitted(self.rig, self.endpoint, self._name, name)
        raise no_reply(self.rig, self.endpoint)


def _encode(request: commands.DaemonRequest) -> bytes:
    """Return a command as JSON; refuse a number that JSON has not, and a text that is no Unicode.

    msgspec encodes NaN and inf as null, which means the default.
    """
    for name in request.__struct_fields__:
        value = getattr(request, name)
        if isinstance(value, float) and not isfinite(value):
            raise InputError(f"{name}={value!r} must be a finite number")
    try:
        return msgspec.json.encode(request)
    except UnicodeEncodeError as err:
        raise InputError(
            f"{request.name}: the text '{printable(str(err.object))}' is no Unicode"
        ) from err


class _Replies:
    """Replies to a query, collected by a thread of zenoh."""

    def __init__(self) -> None:
        self._replies: list[zenoh.Reply] = []
        self._has_ended = threading.Event()
        self.handler = zenoh.handlers.Callback(self._replies.append, self._has_ended.set)

    def wait(self, timeout: float) -> list[zenoh.Reply] | None:
        """Return all replies; None if more may come after `timeout` s."""
        return self._replies if self._has_ended.wait(timeout) else None
