"""Client of a rig's daemon: it sends queries and commands, and receives messages."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self, TypeVar

import msgspec
import zenoh
from armrig_core.access.daemon_lock import living_daemon
from armrig_core.access.endpoint import network_address
from armrig_core.commands import commands
from armrig_core.errors import InputError, MalformedReplyError
from armrig_core.process.standstill import Standstill
from armrig_core.rig.calibration_file import raw_samples, read_calibration
from armrig_core.rig.volts import U_MAX_V
from armrig_core.telemetry import topics

from armrig.rig.replies import (
    BusyError,
    Progress,
    RefusedError,
    complete_recording,
    refusal_of,
    refused,
    reply_of,
    this_user,
)
from armrig.rig.session import (
    LostLinkError,
    NoReplyError,
    RigError,
    ServiceStoppedError,
    configured_endpoint,
    no_daemon,
    no_reply,
    not_permitted,
    open_connection,
    service_has_stopped,
)

if TYPE_CHECKING:  # a stop waits for all imports of this module
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

REPLY_S = 5.0  # longest wait for a reply
_REPLY_PER_SAMPLE_S = 5e-6  # added: before its reply the daemon checks and rehearses all samples
_POLL_INTERVAL_S = 0.1
_REPEAT_INTERVAL_S = 0.02  # between two attempts of a temporarily refused command
# Time for which a temporarily refused command is repeated. The daemon reports its timing once a
# second. A stall can spoil two reports; the third report is good again.
_REPEAT_S = 2.5
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
        self.endpoint = connect or configured_endpoint(rig)
        self._connect = connect
        self._certificate = certificate
        self._name = ""  # name in the certificate, which the keys of commands contain
        self._session: zenoh.Session | None = None
        self._lease = ""
        self._owner = ""
        self._n = 0
        self._limits_v = (0.0, U_MAX_V)
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
            Sampling time in s; by default the configured sampling time.

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
        granted = self._ask_again(commands.Arm(owner=owner, Ts=Ts), commands.LeaseGranted)
        self._lease, self._n, self._owner = granted.lease, 0, owner
        self._limits_v = (granted.u_min, granted.u_max)
        return granted

    def run(
        self,
        u: ArrayLike,
        *,
        pacing: Literal["scheduled", "exchange"] = "scheduled",
        experiment: str = "run",
        details: Mapping[str, Any] | None = None,
        dead_man: float | None = None,
        accepted: Callable[[commands.RunAccepted], None] | None = None,
        progress: Progress | None = None,
        tell: Callable[[str], None] | None = None,
    ) -> Path:
        """Play `u`, wait until the run is recorded, and return the recording's path.

        Every exception during the wait, including Ctrl-C, stops the rig. The lease ends with the
        run: call `arm` again before the next run.

        Parameters
        ----------
        u : array_like, shape (N,)
            Motor voltage at each sample, in V, inside the limits that `arm` returned. N is at least
            1 and at most 4 000 000.
        pacing : {"scheduled", "exchange"}
            Clock that triggers each sample: the device's timer ("scheduled"), or the host
            ("exchange"). With "exchange", the data contain the jitter of the host.
        experiment : str, default "run"
            Kind of experiment, part of the recording's name; allowed are a-z, 0-9 and -.
        details : mapping, optional
            Settings of the experiment, such as its seed; the recording contains them.
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
        voltage = self._allowed(u)
        request = commands.Run(
            **self._stamp(),
            u=voltage.tolist(),
            pacing=pacing,
            experiment=experiment,
            details=dict(details or {}),
            dead_man=dead_man,
        )
        run = None
        try:
            run = self._ask(request, commands.RunAccepted)
            if accepted is not None:
                accepted(run)
            progress, tell = progress or (lambda done, total: None), tell or (lambda sentence: None)
            last = self._finished(request, run, progress, tell)
            self.last_run = last
        except BaseException as err:
            if run is None and isinstance(err, RefusedError):
                raise  # no run began
            self._lease = ""
            with suppress(RigError):
                self.stop()
            raise
        self._lease = ""
        return complete_recording(last, voltage.size)

    def _finished(
        self,
        request: commands.Run,
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
                what = f"rig {self.rig}: link lost after {done} or more of {len(request.u)} samples"
                status = self._status_over_link(what, until_s, tell)
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
                total = len(request.u)
                done = total if last.is_complete else last.samples
                progress(done, total)
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

    def set(self, u: float) -> None:
        """Hold a voltage until the next `set`, for at most the time `period_s` that `arm` returned.

        Parameters
        ----------
        u : float
            Motor voltage in V, inside the limits that `arm` returned.

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
        (volts,) = self._allowed([u])
        self._ask(commands.Set(**self._stamp(), u=float(volts)), commands.Done)

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
            reply = self._ask(commands.Stop(by=who), commands.Done)
        except RefusedError:
            # A name must not prevent a stop, for example if the command is too long.
            reply = self._ask(commands.Stop(), commands.Done)
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
        request = commands.Note(text=text, owner=(owner or self._owner or this_user())[:80])
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
        return self._ask_again(commands.Reset(), commands.Done).done

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
        found = read_calibration(Path(path))
        request = commands.Calibrate(calibration=found, raw=raw_samples(found))
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
        self._ask(commands.Disarm(**stamp), commands.Done)

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

        return listen(self._connected(), topics.stream_key(self.rig, name), self.endpoint)

    def arrivals(self, name: str) -> AbstractContextManager[Callable[[], list[Any]]]:
        """Yield, for a `with` block, a function that returns the messages since its last call.

        Examples
        --------
        >>> import time
        >>> with armrig.Rig("1") as rig:
        ...     with rig.arrivals("sample") as new_samples:
        ...         time.sleep(0.5)
        ...         samples = new_samples()
        >>> len(samples) > 0
        True
        """
        from armrig.rig.telemetry_stream import arrivals

        return arrivals(self._connected(), topics.stream_key(self.rig, name))

    def _allowed(self, u: ArrayLike) -> NDArray[np.float64]:
        """Return the voltages (N,); raise ValueError if a voltage is outside the limits."""
        import numpy as np

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

    def _stamp(self) -> dict[str, Any]:
        if not self._lease:
            raise RefusedError(f"rig {self.rig} is not armed by this client: call arm(owner) first")
        self._n += 1
        return {"lease": self._lease, "n": self._n}

    def _connected(self) -> zenoh.Session:
        if self._session is None:
            raise RigError('a Rig is used in a with block: with armrig.Rig("1") as rig: …')
        return self._session

    def _ask_again(self, request: commands.Request, answer: type[_R]) -> _R:
        """Send a command; if it is refused temporarily, repeat it for up to `_REPEAT_S`."""
        until = time.monotonic() + _REPEAT_S
        while True:
            try:
                return self._ask(request, answer)
            except BusyError:
                if time.monotonic() > until:
                    raise
            time.sleep(_REPEAT_INTERVAL_S)

    def _ask(self, request: commands.Request, answer: type[_R]) -> _R:
        key = topics.command_key(self.rig, request.name, self._name)
        payload = msgspec.json.encode(request)
        if self._name and len(payload) > commands.MOST_REMOTE_BYTES:
            raise RigError(
                f"the command {request.name} has {len(payload)} B; over a network at most "
                f"{commands.MOST_REMOTE_BYTES} B are allowed: play the input in parts, or on the "
                "rig's own machine"
            )
        replies = self._connected().get(
            key, payload=payload, encoding="application/json", timeout=longest_reply_s(request)
        )
        try:
            for reply in replies:
                if reply.ok is not None:
                    return reply_of(request.name, reply.ok.payload.to_bytes(), answer)
                if reply.err is None or (error := reply.err.payload.to_bytes()) == _TIMEOUT:
                    continue
                raise refused(refusal_of(request.name, error))
        except MalformedReplyError as err:
            raise no_daemon(self.rig, self.endpoint, str(err)) from err
        if self._name:
            raise not_permitted(self.rig, self.endpoint, self._name, request.name)
        raise no_reply(self.rig, self.endpoint)


def longest_reply_s(request: commands.Request) -> float:
    """Return the longest time, in s, to wait for the reply to a command."""
    samples = len(request.u) if isinstance(request, commands.Run) else 0
    return REPLY_S + _REPLY_PER_SAMPLE_S * samples
