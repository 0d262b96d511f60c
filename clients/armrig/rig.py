"""A rig at work: ask its daemon, command it, listen to it."""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Self, TypeVar

import msgspec
import numpy as np
import zenoh
from armrig_core import commands, protobuf, telemetry, topics
from armrig_core.endpoint import endpoint, socket_directory
from armrig_core.volts import U_MAX_V
from numpy.typing import ArrayLike, NDArray

Progress = Callable[[int, int], None]
"""Called with the samples taken and the samples asked for."""

REPLY_S = 5.0
"""How long a reply may take, in s."""
_POLL_S = 0.1
_LISTEN_S = 0.002
_RING = 10_000  # samples that a slow listener may be behind before it misses some
_MESSAGES = {
    "gap": protobuf.GAP,
    "event": protobuf.LOG,
    "timing": protobuf.TIMING,
    "state": protobuf.STATE,
}
_R = TypeVar("_R")


class RigError(RuntimeError):
    """What a rig, or the way to it, refuses; says what to do."""


class NoReplyError(RigError):
    """Nobody answers."""


class RefusedError(RigError):
    """The daemon refuses a command, which had no effect."""


class RunEndedError(RigError):
    """A run ended before its last sample."""

    def __init__(self, message: str, recording: Path) -> None:
        super().__init__(message)
        self.recording = recording


class Rig:
    """One rig, through the daemon that runs it; to be used in a `with` block.

    Parameters
    ----------
    rig : str, default "1"
        Its id.
    connect : str, optional
        Endpoint of the daemon; by default the socket that a daemon of the same user listens on.

    Raises
    ------
    NoReplyError
        On entering: there is no daemon at the endpoint.
    ValueError
        The id is none.
    """

    def __init__(self, rig: str = "1", *, connect: str | None = None) -> None:
        self.rig = topics.check_rig_id(rig)
        self.endpoint = connect or default_endpoint(rig)
        self._session: zenoh.Session | None = None
        self._lease = ""
        self._n = 0

    def __enter__(self) -> Self:
        """Connect."""
        self._session = open_session(self.endpoint, rig=self.rig)
        return self

    def __exit__(self, *_: object) -> None:
        """Give the rig back where it is ours, and disconnect."""
        if self._session is None:
            return
        try:
            if self._lease:
                # The lease may be gone, and the daemon too; both are as good as given back.
                with suppress(RigError):
                    self.disarm()
        finally:
            self._session.close()
            self._session = None

    def status(self) -> commands.StatusReport:
        """Return how the daemon is."""
        return self._ask(commands.Status(), commands.StatusReport)

    def arm(self, owner: str, Ts: float | None = None) -> commands.LeaseGranted:
        """Take the rig, at 0 V, with the sampling time `Ts` in s or the configured one."""
        granted = self._ask(commands.Arm(owner=owner, Ts=Ts), commands.LeaseGranted)
        self._lease, self._n = granted.lease, 0
        return granted

    def run(
        self,
        u: ArrayLike,
        *,
        experiment: str = "run",
        details: Mapping[str, Any] | None = None,
        progress: Progress | None = None,
    ) -> Path:
        """Play `u` (N,) in V, wait until it is recorded, and return the recording's path.

        Whatever ends the wait early, Ctrl-C too, stops the rig. With the run the lease ends: `arm`
        again for the next one.

        Raises
        ------
        RunEndedError
            The run ended before its last sample; the recording holds what there was.
        RefusedError
            The rig is not armed, or a value is not allowed.
        ValueError
            A voltage is outside 0 … 5 V or no number; nothing was sent.
        """
        voltage = _inside(u)
        request = commands.Run(
            **self._stamp(),
            u=voltage.tolist(),
            experiment=experiment,
            details=dict(details or {}),
        )
        accepted = self._ask(request, commands.RunAccepted)
        try:
            last = self._finished(accepted, voltage.size, progress or (lambda done, total: None))
        except BaseException:
            with suppress(RigError):
                self.stop()
            raise
        finally:
            self._lease = ""
        recording = Path(last.recording)
        if last.outcome != "complete":
            msg = f"the run ended after {last.samples} of {voltage.size} samples: {last.outcome}; "
            msg += f"recorded in {recording}"
            raise RunEndedError(msg, recording)
        return recording

    def _finished(
        self, accepted: commands.RunAccepted, total: int, progress: Progress
    ) -> commands.LastRun:
        while True:
            status = self.status()
            last = status.last_run
            if last is None or last.run_id != accepted.run_id:
                msg = f"the daemon does not know the run {accepted.run_id} any more: it was "
                msg += "started anew meanwhile; look at its log"
                raise RigError(msg)
            # A complete run may be short of samples that are missing; it is at its end, too.
            progress(total if last.outcome == "complete" else last.samples, total)
            if last.finished and status.phase != "active":
                return last
            time.sleep(_POLL_S)

    def set(self, u: float) -> None:
        """Hold `u` volts until the next `set`, or the end of the lease's period."""
        (volts,) = _inside([u])
        self._ask(commands.Set(**self._stamp(), u=float(volts)), commands.Done)

    def stop(self) -> None:
        """Go to 0 V; needs no lease."""
        self._ask(commands.Stop(), commands.Done)

    def reset(self) -> None:
        """Leave a latched fault, disarmed."""
        self._ask(commands.Reset(), commands.Done)

    def disarm(self) -> None:
        """Give the rig back, at 0 V."""
        stamp = self._stamp()
        self._lease = ""
        self._ask(commands.Disarm(**stamp), commands.Done)

    def stream(self, name: str = "sample") -> Iterator[Any]:
        """Iterate over what the rig publishes from now on: see `stream`."""
        return listen(self._connected(), topics.stream_key(self.rig, name))

    def _stamp(self) -> dict[str, Any]:
        if not self._lease:
            msg = f"rig {self.rig} is not ours: call arm(owner) first"
            raise RefusedError(msg)
        self._n += 1
        return {"lease": self._lease, "n": self._n}

    def _connected(self) -> zenoh.Session:
        if self._session is None:
            msg = 'a Rig is used in a with block: with armrig.Rig("1") as rig: …'
            raise RigError(msg)
        return self._session

    def _ask(self, request: commands.Request, answer: type[_R]) -> _R:
        key = topics.command_key(self.rig, request.name)
        payload = msgspec.json.encode(request)
        replies = self._connected().get(
            key, payload=payload, encoding="application/json", timeout=REPLY_S
        )
        for reply in replies:
            if reply.ok is not None:
                return msgspec.json.decode(reply.ok.payload.to_bytes(), type=answer)
            if reply.err is not None:
                raise _refusal(request.name, reply.err.payload.to_bytes())
        raise no_reply(self.rig, self.endpoint)


def stream(key: str, *, connect: str | None = None) -> Iterator[Any]:
    """Iterate over the live messages of a key such as `rig/1/sample`.

    Samples are `armrig_core.telemetry.Sample`, everything else protobuf messages. A listener that
    falls behind misses the oldest ones: a break in `k` shows it.

    Raises
    ------
    NoReplyError
        There is no daemon, or it went away.
    ValueError
        The key is no stream of a rig.
    """
    rig, _ = _stream_of(key)
    where = connect or default_endpoint(rig)
    with open_session(where, rig=rig) as session:
        yield from listen(session, key)


def listen(session: zenoh.Session, key: str) -> Iterator[Any]:
    """Iterate over the messages of a key in an open session: see `stream`."""
    rig, name = _stream_of(key)
    # A ring, not a queue: one that nobody drains would block zenoh's own thread.
    with (
        session.declare_subscriber(key, zenoh.handlers.RingChannel(_RING)) as subscriber,
        session.liveliness().declare_subscriber(
            topics.alive_key(rig), zenoh.handlers.RingChannel(8)
        ) as alive,
    ):
        while True:
            while (received := subscriber.try_recv()) is not None:
                yield decoded(name, received.payload.to_bytes())
            if (change := alive.try_recv()) is not None and change.kind == zenoh.SampleKind.DELETE:
                msg = f"rig {rig}: its daemon went away"
                raise NoReplyError(msg)
            time.sleep(_LISTEN_S)


def decoded(name: str, payload: bytes) -> Any:
    """Return one message of the stream `name`."""
    if name != "sample":
        return protobuf.message_class(_MESSAGES[name]).FromString(payload)
    sample = telemetry.decode_sample(payload)
    if sample is not None:
        return sample
    # A later version's, with more fields.
    message = protobuf.message_class(protobuf.SAMPLE).FromString(payload)
    return telemetry.Sample._make(getattr(message, field) for field in telemetry.Sample._fields)


def default_endpoint(rig: str) -> str:
    """Return where the daemon of this user and rig listens."""
    directory = socket_directory(os.environ, uid=os.getuid(), temporary=tempfile.gettempdir())
    return endpoint(rig, directory)


def open_session(where: str, *, rig: str) -> zenoh.Session:
    """Return a zenoh session as a client of the endpoint `where`; it must be closed.

    Raises
    ------
    NoReplyError
        Nobody listens there.
    """
    config = zenoh.Config()
    for key, value in (
        ("mode", "client"),
        ("connect/endpoints", [where]),
        # Only the endpoint asked for: nobody is looked for, nobody is told of.
        ("scouting/multicast/enabled", False),
        ("scouting/gossip/enabled", False),
        ("transport/shared_memory/enabled", False),
    ):
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError as err:
            msg = f"{where!r} is no zenoh endpoint, such as unixsock-stream/run/armrig/1.sock"
            raise RigError(msg) from err
    try:
        return zenoh.open(config)
    except zenoh.ZError as err:
        raise no_reply(rig, where) from err


def no_reply(rig: str, where: str) -> NoReplyError:
    """Return the error of a daemon that does not answer."""
    return NoReplyError(
        f"no reply from rig {rig} at {where}: not running, or not permitted; "
        "start it with `armrigd run`, or give its endpoint with --connect"
    )


def _inside(u: ArrayLike) -> NDArray[np.float64]:
    """Return the voltages (N,), or refuse them: never clamped, and never sent."""
    volts = np.atleast_1d(np.asarray(u, dtype=np.float64)).ravel()
    outside = ~((volts >= 0) & (volts <= U_MAX_V))  # NaN is outside, too
    if outside.any():
        k = int(np.argmax(outside))
        msg = f"u[{k}] = {volts[k]:g} V is outside 0 … {U_MAX_V:g} V, where the rig is destroyed"
        raise ValueError(msg)
    return volts


def _refusal(name: str, payload: bytes) -> RefusedError:
    try:
        return RefusedError(msgspec.json.decode(payload, type=commands.Refused).error)
    except msgspec.DecodeError:
        return RefusedError(f"{name}: {payload[:200].decode(errors='replace')}")


def _stream_of(key: str) -> tuple[str, str]:
    parts = key.split("/")
    if len(parts) != 3 or parts[0] != "rig" or parts[2] not in topics.STREAMS:
        msg = f"key {key!r}: a stream is rig/<id>/ and one of {', '.join(topics.STREAMS)}"
        raise ValueError(msg)
    return topics.check_rig_id(parts[1]), parts[2]
