"""The client of a rig: it asks the daemon, commands it, and listens to it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import Any, Literal, Self, TypeVar

import msgspec
import numpy as np
import zenoh
from armrig_core import commands, topics
from armrig_core.calibration_file import raw_samples, read_calibration
from armrig_core.errors import InputError, MalformedReplyError
from armrig_core.volts import U_MAX_V
from numpy.typing import ArrayLike, NDArray

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
    RigError,
    configured_endpoint,
    no_daemon,
    no_reply,
    not_permitted,
    open_connection,
    service_has_stopped,
)
from armrig.rig.telemetry_stream import arrivals, listen

REPLY_S = 5.0  # how long a reply may take
_REPLY_PER_SAMPLE_S = 5e-6  # longer: each sample of a run is read, checked and rehearsed first
_POLL_S = 0.1
_AGAIN_S = 0.02  # until a command that was refused for the moment is repeated
# How long a command is repeated that the daemon refuses only until it, or the device, is ready. The
# daemon reports its timing once a second, and a stall may spoil two reports: the next one is clean.
_SETTLE_S = 2.5
_R = TypeVar("_R")
_TIMEOUT = b"Timeout"  # of zenoh: the daemon's own answers are JSON


class Rig:
    """One rig, through the daemon that runs it; to be used in a `with` block.

    Parameters
    ----------
    rig : str, default "1"
        Its id.
    connect : str, optional
        Endpoint of the daemon; by default that of `[client]` in the configuration, else the socket
        of this user's daemon, else that of this machine's service.
    certificate : str or Path, optional
        Our credential, for an endpoint such as tls/lab-1.local:7447; by default that of `[client]`.

    Raises
    ------
    NoReplyError
        On entering: there is no daemon at the endpoint, or it does not let us in.
    RigError
        On entering: the directory of that socket may be another user's, or the credential cannot
        be used.
    ValueError
        The id is not valid.
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
        self._name = ""  # that in the certificate, which stands in the keys of our commands
        self._session: zenoh.Session | None = None
        self._lease = ""
        self._owner = ""
        self._n = 0
        self._limits_v = (0.0, U_MAX_V)
        self.last_run: commands.LastRun | None = None
        """What the daemon said of the newest run that `run` has waited for."""

    def __enter__(self) -> Self:
        """Connect."""
        self._session, self.endpoint, self._name = open_connection(
            self._connect, rig=self.rig, certificate=self._certificate
        )
        return self

    def __exit__(self, *_: object) -> None:
        """Give the rig back where it is ours, and disconnect."""
        if self._session is None:
            return
        try:
            if self._lease:
                # Where the lease or the daemon is gone, there is nothing left to give back.
                with suppress(RigError):
                    self.disarm()
        finally:
            self._session.close()
            self._session = None

    def status(self) -> commands.StatusReport:
        """Return how the daemon is; asks again, for up to 2.5 s, where others ask too much."""
        return self._ask_again(commands.Status(), commands.StatusReport)

    def arm(self, owner: str, Ts: float | None = None) -> commands.LeaseGranted:
        """Take the rig, at 0 V; repeats a command refused for the moment only, for up to 2.5 s.

        Parameters
        ----------
        owner : str
            Who takes it, for others to read; 1 to 80 characters.
        Ts : float, optional
            Sampling time in s; the configured one where it is left out.

        Returns
        -------
        LeaseGranted
            The sampling time in force, in s, and the voltages allowed, in V: `u_min`, `u_max`.

        Raises
        ------
        RefusedError
            Somebody else has the rig, it is in a fault, or `Ts` is not possible; a `BusyError`
            where the rig, or its host, was not ready in all that time.
        NoReplyError
            The daemon does not answer.
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
    ) -> Path:
        """Play `u`, wait until it is recorded, and return the recording's path.

        Whatever ends the wait early, Ctrl-C too, stops the rig. With the run the lease ends: `arm`
        again for the next one.

        Parameters
        ----------
        u : array_like, shape (N,)
            Motor voltage at each sample, in V, inside what `arm` granted; N from 1 to 4 000 000.
        pacing : {"scheduled", "exchange"}
            Who makes the samples: the device's timer, or the host at each tick, which shows the
            host's jitter as data.
        experiment : str, default "run"
            Kind of experiment, of a-z, 0-9 and -; part of the recording's name.
        details : mapping, optional
            What the experiment was made of, such as its seed; kept in the recording.
        dead_man : float, optional
            The daemon stops the run when this process has given no sign for so long, in s, 0.5 to
            60: killed, frozen, or cut off. Left out, the run plays on without this process. A sign
            is given after each call of `progress`, so a call that takes longer ends the run.
        accepted : callable, optional
            Called once with the daemon's answer, when the run begins: its `rehearsal` says what
            the model of the rig does.
        progress : callable, optional
            Called with the samples taken and the samples asked for, some ten times a second.

        Returns
        -------
        Path
            The recording, complete on the disk of the daemon, which is asked for it: what is
            returned survives a loss of power. `last_run` counts its samples.

        Raises
        ------
        RunEndedError
            The run ended before its last sample; the recording holds what there was.
        RefusedError
            The rig is not armed, a value is not allowed, or the rehearsal leaves the limits.
        ValueError
            `u` is not (N,), or a voltage is not allowed or no number; nothing was sent.
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
            last = self._finished(request, run, progress or (lambda done, total: None))
            self.last_run = last
        except BaseException as err:
            if run is None and isinstance(err, RefusedError):
                raise  # nothing began
            self._lease = ""
            with suppress(RigError):
                self.stop()
            raise
        self._lease = ""
        return complete_recording(last, voltage.size)

    def _finished(
        self, request: commands.Run, run: commands.RunAccepted, progress: Progress
    ) -> commands.LastRun:
        while True:
            wait_s = _AGAIN_S
            # In a flood of others' commands ours may be refused. The run goes on, and so do we, one
            # try at a time: a sign of life must not wait behind several.
            with suppress(BusyError):
                status = self._ask(commands.Status(), commands.StatusReport)
                wait_s = _POLL_S
                last = status.last_run
                if last is None or last.run_id != run.run_id:
                    if stopped := service_has_stopped(self.rig, self.endpoint):
                        raise RigError(stopped)
                    raise RigError(
                        f"the daemon does not know the run {run.run_id} any more: it was "
                        "started anew meanwhile; `armrig ls` shows what it had recorded"
                    )
                # A complete run may lack samples that are missing; it has ended all the same.
                total = len(request.u)
                progress(total if last.is_complete else last.samples, total)
                if last.finished and status.phase != "active":
                    return last
            if request.dead_man is not None:
                # The sign comes from this very wait: a thread would go on for a client that hangs.
                with suppress(RefusedError):  # it has just ended
                    self._ask(commands.Renew(**self._stamp()), commands.Done)
            time.sleep(wait_s)

    def set(self, u: float) -> None:
        """Hold a voltage until the next `set`, or the end of the lease's period.

        Parameters
        ----------
        u : float
            Motor voltage in V, inside what `arm` granted.

        Raises
        ------
        RefusedError
            The rig is not armed, or not ours any more.
        ValueError
            The voltage is not allowed or no number; nothing was sent.
        """
        (volts,) = self._allowed([u])
        self._ask(commands.Set(**self._stamp(), u=float(volts)), commands.Done)

    def stop(self, by: str = "") -> None:
        """Go to 0 V; needs no lease, and ends whatever runs.

        Parameters
        ----------
        by : str, optional
            Who stops it, as the recording will say; by default the owner whom the rig was armed
            for, or this user.

        Raises
        ------
        NoReplyError
            The daemon does not answer; the device itself stops soon after a daemon that is gone.
        RigError
            What answers does not confirm the stop: pull the motor's plug.
        """
        who = by or self._owner or this_user()
        try:
            reply = self._ask(commands.Stop(by=who), commands.Done)
        except RefusedError:
            # A daemon of an earlier version takes a stop of nobody only.
            reply = self._ask(commands.Stop(), commands.Done)
        if not reply.done:
            raise no_daemon(self.rig, self.endpoint, "the answer to 'stop' does not say done")

    def note(self, text: str, owner: str = "") -> bool:
        """Write a note into the recording of the run in hand; needs no lease.

        Repeats a note that is refused for the moment only, for up to 2.5 s.

        Parameters
        ----------
        text : str
            What happened, such as that somebody touched the arm; 1 to 500 characters that print.
        owner : str, optional
            Author; by default the owner whom the rig was armed for, or this user.

        Returns
        -------
        bool
            Whether a recording is being written, and so contains the note.

        Raises
        ------
        RefusedError
            The daemon is older than notes; a `BusyError` after too many notes.
        NoReplyError
            The daemon does not answer.
        ValueError
            The text is not allowed; nothing was sent.
        """
        commands.check_note(text)  # a network drops what is too long, and nobody would answer
        request = commands.Note(text=text, owner=(owner or self._owner or this_user())[:80])
        try:
            return self._ask_again(request, commands.Done).done
        except BusyError:
            raise
        except RefusedError as err:
            if self._has_command(request.name):
                raise
            raise RefusedError(
                f"the daemon of rig {self.rig} takes no notes: update armrig on its machine"
            ) from err

    def reset(self) -> bool:
        """Leave a latched fault, disarmed; return whether there was one."""
        return self._ask_again(commands.Reset(), commands.Done).done

    def calibrate(self, path: str | Path) -> None:
        """Have the daemon use the calibration in a TOML of `armrig calibrate` until it ends.

        It is taken while the rig is safe only, and converts the samples from the next one on;
        repeats a command refused for the moment only, for up to 2.5 s.

        Parameters
        ----------
        path : str or Path
            The file; the samples that it was estimated from lie beside it.

        Raises
        ------
        FileError
            The file holds no calibration; a ValueError.
        RefusedError
            Somebody has the rig, it is in a fault, or the calibration is of another one.
        """
        found = read_calibration(Path(path))
        request = commands.Calibrate(calibration=found, raw=raw_samples(found))
        self._ask_again(request, commands.Done)

    def disarm(self) -> None:
        """Give the rig back, at 0 V."""
        stamp = self._stamp()
        self._lease = ""
        self._ask(commands.Disarm(**stamp), commands.Done)

    def stream(self, name: str = "sample") -> Iterator[Any]:
        """Iterate over what the rig publishes from now on: see `armrig.stream`."""
        return listen(self._connected(), topics.stream_key(self.rig, name), self.endpoint)

    def arrivals(self, name: str) -> AbstractContextManager[Callable[[], list[Any]]]:
        """Give, in a `with` block, a function that returns at once what a stream has brought."""
        return arrivals(self._connected(), topics.stream_key(self.rig, name))

    def _allowed(self, u: ArrayLike) -> NDArray[np.float64]:
        """Return the voltages (N,), or refuse them: they are never clamped."""
        volts = np.asarray(u, dtype=np.float64)
        if volts.ndim != 1 or volts.size == 0:
            raise InputError(
                f"u has shape {volts.shape}, it must be (N,) with N >= 1: one voltage a sample"
            )
        lowest, highest = self._limits_v
        outside = ~((volts >= lowest) & (volts <= highest))  # NaN is outside, too
        if outside.any():
            k = int(np.argmax(outside))
            raise InputError(
                f"u[{k}] = {volts[k]:g} V is outside {lowest:g} … {highest:g} V, what rig "
                f"{self.rig} allows; beyond 0 … {U_MAX_V:g} V it is destroyed"
            )
        return volts

    def _stamp(self) -> dict[str, Any]:
        if not self._lease:
            raise RefusedError(f"rig {self.rig} is not ours: call arm(owner) first")
        self._n += 1
        return {"lease": self._lease, "n": self._n}

    def _has_command(self, name: str) -> bool:
        """Return whether the daemon serves the schema of a command."""
        key = topics.schema_key(self.rig, f"cmd/{name}")
        return any(reply.ok for reply in self._connected().get(key, timeout=REPLY_S))

    def _connected(self) -> zenoh.Session:
        if self._session is None:
            raise RigError('a Rig is used in a with block: with armrig.Rig("1") as rig: …')
        return self._session

    def _ask_again(self, request: commands.Request, answer: type[_R]) -> _R:
        """Repeat a command that is refused for the moment only, for up to `_SETTLE_S`."""
        until = time.monotonic() + _SETTLE_S
        while True:
            try:
                return self._ask(request, answer)
            except BusyError:
                if time.monotonic() > until:
                    raise
            time.sleep(_AGAIN_S)

    def _ask(self, request: commands.Request, answer: type[_R]) -> _R:
        key = topics.command_key(self.rig, request.name, self._name)
        payload = msgspec.json.encode(request)
        if self._name and len(payload) > commands.MOST_REMOTE_BYTES:
            raise RigError(
                f"{request.name}: {len(payload)} B, over a network at most "
                f"{commands.MOST_REMOTE_BYTES} B are allowed: play it in parts, or on the rig's "
                "own machine"
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
    """Return how long the reply to a command may take, in s."""
    samples = len(request.u) if isinstance(request, commands.Run) else 0
    return REPLY_S + _REPLY_PER_SAMPLE_S * samples
