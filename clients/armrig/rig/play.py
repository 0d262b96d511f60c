"""A recording published again, as its daemon published it, under a name that no rig has."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import zenoh
from armrig_core import protobuf
from armrig_core.group_socket import group_may_open
from armrig_core.owned_session import owned_session
from armrig_core.topics import STREAMS, alive_key, schema_key, stream_key

from armrig.recordings.published import Published, PublishedRun
from armrig.rig.session import RigError

_MOST_RECEIVED = 1 << 16  # who listens has nothing to say but its subscriptions
_LONGEST_S = 1.0  # a pause is slept through in pieces: the longest that a file asks for is no float
_LOOK_S = 0.05
Publish = Callable[[str, bytes], None]


class Stage:
    """An open session in which a recording is played; made by `staged`."""

    def __init__(self, session: zenoh.Session, rig: str) -> None:
        self._session = session
        self._publishers = {
            stream: session.declare_publisher(
                stream_key(rig, stream),
                encoding=f"application/protobuf;{protobuf.OF_STREAM[stream]}",
                congestion_control=zenoh.CongestionControl.DROP,
            )
            for stream in STREAMS
        }
        self._served = {
            schema_key(rig, name): protobuf.descriptor_set(name)
            for name in protobuf.OF_STREAM.values()
        }
        # Nothing else is answered: no command, and so no status, which would tell of a rig.
        session.declare_queryable(schema_key(rig, "**"), self._serve_schema)
        self._alive = session.liveliness().declare_token(alive_key(rig))

    def wait_for_listener(self) -> None:
        """Wait until somebody listens to the samples."""
        while not self._is_heard():
            time.sleep(_LOOK_S)

    def _is_heard(self) -> bool:
        status: Any = self._publishers["sample"].matching_status
        return bool(getattr(status, "matching", status))  # an object, and the stubs say a bool

    def publish(self, stream: str, data: bytes) -> None:
        """Publish a message; dropped by zenoh where a subscriber does not keep up."""
        self._publishers[stream].put(data)

    def _serve_schema(self, query: zenoh.Query) -> None:
        with query:
            for key, data in self._served.items():
                if query.key_expr.intersects(zenoh.KeyExpr(key)):
                    query.reply(key, data)


@contextmanager
def staged(where: str, rig: str) -> Iterator[Stage]:
    """Give a session that listens at an endpoint, and in which nobody else publishes or answers.

    Raises
    ------
    RigError
        The endpoint is none, is taken, or cannot be made.
    """
    config = owned_session(where, most_received=_MOST_RECEIVED)
    try:
        with group_may_open():
            session = zenoh.open(zenoh.Config.from_json5(json.dumps(config)))
    except zenoh.ZError as err:
        raise RigError(
            f"{where} cannot be listened at: {rig} may be played there already, then end it; "
            "or it is no zenoh endpoint, such as tcp/127.0.0.1:7447: give another with --listen"
        ) from err
    with session:
        yield Stage(session, rig)


def play(run: PublishedRun, publish: Publish, *, speed: float) -> Iterator[Published]:
    """Publish the messages of a run when they are due; give each when it is published.

    Parameters
    ----------
    publish : callable
        Called with the stream and the bytes of each message.
    speed : float
        How many times as fast as they were recorded.
    """
    began_s, first_t = time.monotonic(), None
    for message in run.messages():
        first_t = message.t if first_t is None else first_t
        _sleep_until(began_s + (message.t - first_t) / speed)
        publish(message.stream, message.data)
        yield message


def rest(run: PublishedRun, *, speed: float) -> None:
    """Wait until the run may begin again: its last sample has its time, too."""
    _sleep_until(time.monotonic() + run.manifest.Ts / speed)


def _sleep_until(due_s: float) -> None:
    while (left_s := due_s - time.monotonic()) > 0:
        time.sleep(min(left_s, _LONGEST_S))
