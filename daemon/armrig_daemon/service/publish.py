"""Publishing to all clients over all endpoints, and the queues of the clients' commands."""

from __future__ import annotations

import contextlib
import queue
import secrets
import threading
from collections.abc import Callable, Iterator
from enum import Enum
from functools import partial
from typing import Self

import zenoh
from armrig_core.commands.codes import RefusalCode
from armrig_core.commands.commands import (
    CalibrateRequest,
    Renew,
    Status,
    StopRequest,
    build_refusal,
)
from armrig_core.errors import OperationError
from armrig_core.rig.channels import DeviceChannel
from armrig_core.telemetry.channels import CHANNELS
from armrig_core.telemetry.history import REPLY_LIMIT, encode_past

from armrig_daemon.service import admission
from armrig_daemon.service.access import Network
from armrig_daemon.service.listener import Command, Listener
from armrig_daemon.service.sentences import endpoint_error, network_error
from armrig_daemon.service.uplink import Uplink

TOO_MANY = build_refusal(RefusalCode.TOO_MANY, "too many commands are waiting: try again")
"""Refusal of a command whose queue is full."""
MAX_DELETED = 8
"""Largest number of deleted sockets whose sessions stay open for the connected clients."""
MAX_WAITING = 64  # most unread commands of one kind; further commands are refused
MOST_HISTORY_BYTES = 2 << 20
"""Largest size of the kept messages, in B: 24 105 samples of 87 B, 24 s at 1 kHz."""


class NetworkError(OperationError):
    """The service cannot listen at the endpoint of a network; the message contains the reason."""


class CommandKind(Enum):
    """Kind of a command; a command waits only for commands of its own kind."""

    STOP = StopRequest.name
    SIGN = Renew.name
    STATUS = Status.name
    LEASED = "leased"
    """Commands of the holder except the signs of life, which are a separate kind."""
    CALIBRATE = CalibrateRequest.name
    """Large and rare commands, of which at most one waits."""
    OTHER = "other"


def kind_of(name: str) -> CommandKind:
    """Return the kind of a command; an unknown command is of the kind OTHER."""
    if name in (StopRequest.name, Renew.name, Status.name, CalibrateRequest.name):
        return CommandKind(name)
    return CommandKind.LEASED if name in admission.LEASED else CommandKind.OTHER


class Session:
    """Listeners at all endpoints; use the session in a `with` block."""

    def __init__(
        self,
        endpoint: str,
        rig: str,
        wake: Callable[[], None],
        network: Network | None = None,
        router: Network | None = None,
        channels: tuple[DeviceChannel, ...] = CHANNELS,
    ) -> None:
        """Listen; zenoh's threads call `wake` when a command has arrived.

        `endpoint` is the endpoint of the Unix socket. The session also listens at the endpoint of
        `network`. It also connects to `router`, as soon as the router answers. `channels` are the
        channels of the rig.

        Raises zenoh.ZError if the endpoint is in use or cannot be created. Raises NetworkError if
        the endpoint of the network is in use or cannot be opened.
        """
        self.lease = b""  # lease in force; with b"", no command with a lease is admitted
        self._waiting = {
            kind: queue.Queue[Command](1 if kind is CommandKind.CALIBRATE else MAX_WAITING)
            for kind in CommandKind
        }
        self._wake = wake
        self._history = History(secrets.token_bytes(16))
        self._endpoint, self._rig, self._network = endpoint, rig, network
        self._listen = partial(Listener, channels=channels)
        self._listeners = [self._listen(endpoint, rig, self._admit, self._past)]
        self._deleted: list[Listener] = []  # their sockets are deleted, their clients are connected
        if why := self.open_network():
            self._listeners[0].close()
            raise NetworkError(why)
        self.uplink: Uplink | None = None
        """Connection to a router; None without a configured router."""
        if router is not None:
            way = partial(self._listen, router.endpoint, rig, self._admit, self._past, router)
            self.uplink = Uplink(router.endpoint, way)

    def __enter__(self) -> Self:
        """Return this session, whose listeners are already open."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the listeners."""
        for listener in (*self._listeners, *self._deleted):
            listener.close()
        if self.uplink is not None:
            self.uplink.close()

    def open_socket(self) -> str:
        """Listen at the deleted Unix socket again; return why it failed, or ""."""
        if len(self._deleted) == MAX_DELETED:
            return f"for the {MAX_DELETED + 1}th time"
        try:
            again = self._listen(self._endpoint, self._rig, self._admit, self._past)
        except zenoh.ZError as err:
            return endpoint_error(self._endpoint, self._rig, err)
        before, self._listeners[0] = self._listeners[0], again
        self._deleted.append(before)
        return ""

    def open_network(self) -> str:
        """Listen also at the endpoint of the network; return why it failed, or ""."""
        if self._network is not None:
            where = self._network.endpoint
            try:
                remote = self._listen(where, self._rig, self._admit, self._past, self._network)
            except zenoh.ZError as err:
                return network_error(where, err)
            self._listeners.append(remote)
        return ""

    def shut_network(self) -> None:
        """End all links of the network and stop listening, in other threads; return at once."""
        shut = self._listeners[1:]
        del self._listeners[1:]
        for listener in shut:
            threading.Thread(target=listener.close, name="closing", daemon=True).start()

    def put(self, stream: str, data: bytes) -> None:
        """Publish a message, which zenoh drops for a slow subscriber; keep it in the history."""
        for listener in (*self._listeners, *self._deleted):
            try:  # for each sample: `suppress` would take a tenth of the time
                listener.put(stream, data)
            except zenoh.ZError:
                continue  # another thread has just shut the network
        if self.uplink is not None:
            self.uplink.put(stream, data)
        self._history.add(stream, data)

    def waiting(self, kind: CommandKind, most: int = MAX_WAITING) -> Iterator[Command]:
        """Iterate over the waiting commands of a kind, at most `most`."""
        with contextlib.suppress(queue.Empty):
            for _ in range(most):
                yield self._waiting[kind].get_nowait()

    @property
    def is_asked(self) -> bool:
        """True while a command waits."""
        return not all(waiting.empty() for waiting in self._waiting.values())

    def _past(self, first: int, clock_offset_ns: int) -> bytes:
        return self._history.reply(first, clock_offset_ns)

    def _admit(self, command: Command) -> None:
        refusal = admission.refusal(command.name, command.payload, self.lease)
        if refusal is not None:
            command.refuse(refusal)
            return
        try:
            self._waiting[kind_of(command.name)].put_nowait(command)
        except queue.Full:
            command.refuse(TOO_MANY)
        self._wake()


class History:
    """Recent messages by number; one thread may add messages while another thread reads.

    zenoh's own cache (its advanced publisher) is not used: see
    docs/decisions/missed-messages-are-requested-from-the-daemon.md.
    """

    def __init__(self, life: bytes, most_bytes: int = MOST_HISTORY_BYTES) -> None:
        """Create an empty history; the 16 B of `life` identify this start of a daemon."""
        self._life, self._most = life, most_bytes
        self._kept: dict[int, tuple[str, bytes]] = {}
        self._first = self._end = self._size = 0

    def add(self, stream: str, data: bytes) -> None:
        """Keep a message, and drop the oldest messages beyond the limit."""
        self._kept[self._end] = (stream, data)
        self._end += 1
        self._size += len(data)
        while self._size > self._most:
            _, oldest = self._kept.pop(self._first)
            self._first += 1
            self._size -= len(oldest)

    def reply(self, first: int, clock_offset_ns: int) -> bytes:
        """Return an answer with the messages from number `first` on, as many as fit into it."""
        number = first = min(max(first, self._first), self._end)
        messages: list[tuple[str, bytes]] = []
        size = 0
        # Another thread may drop the oldest message at this moment, in `add`.
        while size < REPLY_LIMIT and (message := self._kept.get(number)) is not None:
            messages.append(message)
            size += len(message[1])
            number += 1
        return encode_past(self._life, first, clock_offset_ns, messages)
