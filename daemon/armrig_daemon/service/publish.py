"""What the service says to the world and hears from it, whichever way somebody came in."""

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
from armrig_core.codes import RefusalCode
from armrig_core.commands import Calibrate, Renew, Status, Stop, refused
from armrig_core.errors import OperationError

from armrig_daemon.service import admission
from armrig_daemon.service.access import Network
from armrig_daemon.service.history import History
from armrig_daemon.service.listener import Command, Listener
from armrig_daemon.service.uplink import Uplink

TOO_MANY = refused(RefusalCode.TOO_MANY, "too many commands are waiting: try again")
"""What is said to those that there is no room for."""
MOST_WAITING = 64  # commands of a kind that nobody has looked at yet; more are refused


class NetworkError(OperationError):
    """The endpoint of a network cannot be listened at; says why."""


class Kind(Enum):
    """Commands that wait for each other; those of another kind do not stand before them."""

    STOP = Stop.name
    SIGN = Renew.name
    STATUS = Status.name
    LEASED = "leased"
    """Of the holder, a sign of whom is a kind of its own."""
    CALIBRATE = Calibrate.name
    """Long, and seldom: one of them waits at most."""
    OTHER = "other"


def kind_of(name: str) -> Kind:
    """Return the kind of a command, whether there is such a one or not."""
    if name in (Stop.name, Renew.name, Status.name, Calibrate.name):
        return Kind(name)
    return Kind.LEASED if name in admission.LEASED else Kind.OTHER


class Session:
    """Open listeners; use it in a `with` block."""

    def __init__(
        self,
        endpoint: str,
        rig: str,
        wake: Callable[[], None],
        network: Network | None = None,
        router: Network | None = None,
    ) -> None:
        """Listen; `wake` is called, from a thread of zenoh's, when a command has come.

        Parameters
        ----------
        endpoint : str
            Of the Unix socket.
        network : Network, optional
            Where to listen, too.
        router : Network, optional
            Where to connect to, too, as soon as it is there.

        Raises
        ------
        zenoh.ZError
            The endpoint is taken or cannot be made.
        NetworkError
            That of the network is, or cannot.
        """
        self.lease = b""  # the one in force; without it no command of a holder is let in
        self._waiting = {
            kind: queue.Queue[Command](1 if kind is Kind.CALIBRATE else MOST_WAITING)
            for kind in Kind
        }
        self._wake = wake
        self._history = History(secrets.token_bytes(16))
        self._rig, self._network = rig, network
        self._listeners = [Listener(endpoint, rig, self._admit, self._past)]
        if network is not None:
            try:
                self.open_network()
            except NetworkError:
                self._listeners[0].close()
                raise
        self.uplink: Uplink | None = None
        """The way through a router, if there is to be one."""
        if router is not None:
            way = partial(Listener, router.endpoint, rig, self._admit, self._past, router)
            self.uplink = Uplink(router.endpoint, way)

    def __enter__(self) -> Self:
        """Return itself, open."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close."""
        for listener in self._listeners:
            listener.close()
        if self.uplink is not None:
            self.uplink.close()

    def open_network(self) -> None:
        """Listen at the endpoint of the network, too.

        Raises
        ------
        NetworkError
            It cannot be.
        """
        if self._network is None:
            return
        where = self._network.endpoint
        try:
            remote = Listener(where, self._rig, self._admit, self._past, self._network)
        except zenoh.ZError as err:
            raise NetworkError(str(err)) from err
        self._listeners.append(remote)

    def shut_network(self) -> None:
        """End all links of the network, and listen there no more; nobody waits until it is done."""
        for listener in self._listeners[1:]:
            threading.Thread(target=listener.close, name="closing", daemon=True).start()
        del self._listeners[1:]

    def put(self, stream: str, data: bytes) -> None:
        """Publish; dropped by zenoh where a subscriber does not keep up, and kept for a while."""
        for listener in self._listeners:
            listener.put(stream, data)
        if self.uplink is not None:
            self.uplink.put(stream, data)
        self._history.add(stream, data)

    def waiting(self, kind: Kind, most: int = MOST_WAITING) -> Iterator[Command]:
        """Iterate over the commands of a kind that wait, at most so many."""
        with contextlib.suppress(queue.Empty):
            for _ in range(most):
                yield self._waiting[kind].get_nowait()

    @property
    def is_asked(self) -> bool:
        """Whether a command waits."""
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
