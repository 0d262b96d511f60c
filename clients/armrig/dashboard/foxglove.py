"""Streams of the rig for Foxglove and similar programs, which cannot send commands."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from armrig_core.process.imports import imported
from armrig_core.telemetry import protobuf
from armrig_core.telemetry.telemetry import Sample, encode_sample
from armrig_core.telemetry.topics import STREAMS, stream_key

from armrig.physics.files.poses import transforms, transforms_channel
from armrig.rig.client import Rig
from armrig.rig.session import RigError

HOST = "127.0.0.1"
PORT = 8765
LAYOUTS = Path(__file__).parent / "layouts"
"""Folder of the layouts for Foxglove and PlotJuggler; they show the topics of the arm, rig 1."""
_FRAMES = "transforms"
_PERIOD_S = 0.02
"""Period of the messages, in s (50 Hz); only the newest sample of each period is sent."""
_SILENT_S = 3.0
_AGAIN_S = 0.5
_MOST_WAITING = 100  # waiting messages of a slow stream; above this limit, the oldest is dropped


@contextmanager
def foxglove(*, rig: str, connect: str | None, port: int = PORT) -> Iterator[str]:
    """Serve the streams on the loopback interface until the block ends; yield the address.

    The coordinate frames of both parts of the arm are sent with samples. The server has no services
    or parameters, and ignores all messages of a client. The port closes soon after the block,
    because the SDK does not wait for the end of its task that accepts connections.

    Raises MissingPackageError if foxglove-sdk is not installed. Raises RigError if another program
    uses the port.
    """
    sdk = imported("foxglove", "foxglove")
    context = sdk.Context()  # a separate context, so that other logs of this process are not served
    channels = {
        name: sdk.Channel(
            f"/{stream_key(rig, name)}",
            schema=sdk.Schema(
                name=protobuf.OF_STREAM[name],
                encoding="protobuf",
                data=protobuf.descriptor_set(protobuf.OF_STREAM[name]),
            ),
            message_encoding="protobuf",
            context=context,
        )
        for name in STREAMS
    }
    channels[_FRAMES] = transforms_channel(rig, context)
    try:
        server = sdk.start_server(
            name=f"armrig, rig {rig}", host=HOST, port=port, capabilities=[], context=context
        )
    except Exception as err:  # of the SDK's own kind
        raise RigError(f"foxglove: port {port} of {HOST} cannot be opened: {err}") from err
    ends = threading.Event()
    thread = threading.Thread(target=_send, args=(channels, rig, connect, ends), daemon=True)
    thread.start()
    try:
        yield f"ws://{HOST}:{server.port}"
    finally:
        ends.set()
        thread.join(5.0)
        server.stop()


def _send(channels: dict[str, Any], rig: str, connect: str | None, ends: threading.Event) -> None:
    """Forward the messages of the rig, and reconnect to a restarted daemon."""
    while not ends.is_set():
        try:
            with Rig(rig, connect=connect) as opened:
                if opened.status().described.arm:
                    _pass_on(channels, opened, ends)
        except (RigError, ValueError):
            pass  # the dashboard shows the reason
        ends.wait(_AGAIN_S)


def _pass_on(channels: dict[str, Any], rig: Rig, ends: threading.Event) -> None:
    with ExitStack() as open_streams:
        came = {name: open_streams.enter_context(rig.arrivals(name)) for name in STREAMS}
        waiting: dict[str, deque[Any]] = {
            name: deque(maxlen=1 if name == "sample" else _MOST_WAITING) for name in STREAMS
        }
        silent = 0
        while not ends.wait(_PERIOD_S):
            for name, messages in waiting.items():
                messages.extend(came[name]())
                if messages:
                    silent = 0 if name == "sample" else silent
                    message = messages.popleft()
                    channels[name].log(_bytes(message))
                    if isinstance(message, Sample):
                        angles = message.value_0, message.value_1
                        channels[_FRAMES].log(transforms(*angles, time.time_ns()))
            silent += 1
            if silent * _PERIOD_S > _SILENT_S:
                return


def _bytes(message: Any) -> bytes:
    if isinstance(message, Sample):
        return encode_sample(message)
    return bytes(message.SerializeToString())
