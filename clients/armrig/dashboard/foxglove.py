"""Streams and layouts of a rig for Foxglove and similar programs, which cannot send commands."""

from __future__ import annotations

import json
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from copy import deepcopy
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

from armrig_core.process.imports import load_extra
from armrig_core.rig.channels import symbol
from armrig_core.rig.description import Description
from armrig_core.telemetry import protobuf
from armrig_core.telemetry.telemetry import Sample, encode_sample
from armrig_core.telemetry.topics import STREAMS, stream_key

from armrig.physics.files.poses import transforms, transforms_channel
from armrig.rig.client import Rig
from armrig.rig.session import RigError

HOST = "127.0.0.1"
PORT = 8765
_TEMPLATES = Path(__file__).parent / "layouts"
_RATE_LIMIT = 15.0  # of an axis, in rad/s: a wrap of the angle makes a peak of hundreds
_COLOURS = ("#1f77b4", "#d62728", "#9467bd", "#2ca02c", "#9467bd")
_FRAMES = "transforms"
_PERIOD_S = 0.02
"""Period of the messages, in s (50 Hz); only the newest sample of each period is sent."""
_SILENT_S = 3.0
_AGAIN_S = 0.5
_MOST_WAITING = 100  # waiting messages of a slow stream; above this limit, the oldest is dropped


@contextmanager
def foxglove(
    described: Description, *, rig: str, connect: str | None, port: int = PORT
) -> Iterator[str]:
    """Serve the streams of a rig on the loopback interface until the block ends; yield the address.

    For the arm, the coordinate frames of its two parts are sent, too. The server has no services
    or parameters, and ignores all messages of a client. The port closes soon after the block,
    because the SDK does not wait for the end of its task that accepts connections.

    Raises MissingPackageError if foxglove-sdk is not installed. Raises RigError if another program
    uses the port.
    """
    sdk = load_extra("foxglove", "foxglove")
    context = sdk.Context()  # a separate context, so that other logs of this process are not served
    channels = {
        name: sdk.Channel(
            f"/{stream_key(rig, name)}",
            schema=sdk.Schema(
                name=protobuf.OF_STREAM[name],
                encoding="protobuf",
                data=protobuf.descriptor_set(protobuf.OF_STREAM[name], described.channels),
            ),
            message_encoding="protobuf",
            context=context,
        )
        for name in STREAMS
    }
    if described.arm:
        channels[_FRAMES] = transforms_channel(rig, context)
    try:
        server = sdk.start_server(
            name=f"armrig, rig {rig}", host=HOST, port=port, capabilities=[], context=context
        )
    except Exception as err:  # of the SDK's own kind
        raise RigError(f"foxglove: port {port} of {HOST} cannot be opened: {err}") from err
    ends = threading.Event()
    of_rig = channels, rig, connect, described.text, ends
    thread = threading.Thread(target=_send, args=of_rig, daemon=True)
    thread.start()
    try:
        yield f"ws://{HOST}:{server.port}"
    finally:
        ends.set()
        thread.join(5.0)
        server.stop()


def _send(
    channels: dict[str, Any], rig: str, connect: str | None, text: bytes, ends: threading.Event
) -> None:
    """Forward the messages of the rig with this description; reconnect to a restarted daemon."""
    while not ends.is_set():
        try:
            with Rig(rig, connect=connect) as opened:
                if opened.status().described.text == text:
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
                    if isinstance(message, Sample) and _FRAMES in channels:
                        angles = message.value_0, message.value_1
                        channels[_FRAMES].log(transforms(*angles, time.time_ns()))
            silent += 1
            if silent * _PERIOD_S > _SILENT_S:
                return


def _bytes(message: Any) -> bytes:
    if isinstance(message, Sample):
        return encode_sample(message)
    return bytes(message.SerializeToString())


class _Curve(NamedTuple):
    """A curve of a layout: a field of a sample, or the rate of the field."""

    label: str
    unit: str
    field: str
    ends: tuple[float, float] | None = None
    is_rate: bool = False


def layouts(rig: str, description: Description) -> dict[str, str]:
    """Return the layouts for Foxglove and PlotJuggler of a rig's topics, by the file's name."""
    curves = [_Curve(symbol(description.input.name), "V", "u_applied_v", (0.0, 5.0))]
    for c in description.channels:
        curves.append(_Curve(symbol(c.name), c.unit, c.value_field))
        if c.turns:
            label, unit = f"rate of {symbol(c.name)}", f"{c.unit}/s"
            ends = (-_RATE_LIMIT, _RATE_LIMIT)
            curves.append(_Curve(label, unit, c.value_field, ends, is_rate=True))
    topics = f"/rig/{rig}/"
    return {
        "armrig.foxglove-layout.json": _foxglove_layout(curves, topics, description),
        "armrig.plotjuggler.xml": _plotjuggler_layout(curves, topics),
    }


def _template(name: str, topics: str) -> str:
    return (_TEMPLATES / name).read_text(encoding="utf-8").replace("/rig/RIG/", topics)


def _foxglove_layout(curves: list[_Curve], topics: str, description: Description) -> str:
    made = json.loads(_template("foxglove.json", topics))
    panels, layout = made["configById"], made["layout"]
    plot = panels.pop("Plot")
    stacked: Any = None  # plots of the same height, one below the other
    for n, (label, unit, field, ends, is_rate) in enumerate(reversed(curves), 1):
        value = f"{topics}sample.{field}{'.@derivative' * is_rate}"
        path = plot["paths"][0] | {"value": value, "label": label}
        limits = dict(zip(("minYValue", "maxYValue"), ends or (), strict=False))
        own = {"paths": [path], "yAxisLabel": unit, "foxglovePanelTitle": label} | limits
        name = f"Plot!{label}"
        panels[name] = plot | own
        share = {"direction": "column", "splitPercentage": round(100 / n)}
        stacked = share | {"first": name, "second": stacked} if stacked else name
    layout["first"] = stacked
    if not description.arm:
        del panels["3D!rig"]
        layout["second"] = layout["second"]["second"]
    return json.dumps(made, ensure_ascii=False, indent=1)


def _plotjuggler_layout(curves: list[_Curve], topics: str) -> str:
    root = ElementTree.fromstring(_template("plotjuggler.xml", topics))
    (splitter,), (snippets,) = root.iter("DockSplitter"), root.iter("customMathEquations")
    area, rate = splitter[0], snippets[0]
    splitter.remove(area)
    snippets.remove(rate)
    for place, (label, unit, field, ends, is_rate) in enumerate(curves):
        source = f"{topics}sample/{field}"
        made = deepcopy(area)
        made.set("name", f"{label} ({unit})")
        (plot,), (limits,), (curve,) = (made.iter(tag) for tag in ("plot", "limitY", "curve"))
        curve.attrib |= {"name": label if is_rate else source, "color": _COLOURS[place]}
        if is_rate:
            snippet = deepcopy(rate)
            snippet.set("name", label)
            snippet.find("linked_source").text = source  # type: ignore[union-attr]
            snippets.insert(0, snippet)
        elif ends:
            plot.set("style", "Steps")
            limits.attrib |= {"min": f"{ends[0]:g}", "max": f"{ends[1]:g}"}
        splitter.insert(place, made)
    n = len(curves)  # plots, and the states below them
    splitter.attrib |= {"count": f"{n + 1}", "sizes": ";".join([*[f"{0.9 / n:.3f}"] * n, "0.1"])}
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True)
