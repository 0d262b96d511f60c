"""Names in the layouts for Foxglove and PlotJuggler, and in an MCAP file or a channel."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import cache
from math import atan2, remainder, tau
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from armrig.dashboard.foxglove import layouts
from armrig_core.rig.description import Description, builtin
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader

ARM = builtin("arm")
Kinds = dict[str, str]
"""`number` or `text` by topic and field, such as /rig/1/sample.alpha_rad; "" for a topic."""


def foxglove_paths(described: Description = ARM) -> Kinds:
    """Return each message path of Foxglove's layout of rig 1, and what its panel shows of it."""
    panels = json.loads(layouts("1", described)["armrig.foxglove-layout.json"])["configById"]
    found: Kinds = {}
    for name, panel in panels.items():
        kind = "number" if name.startswith("Plot!") else "text"
        found |= {p["value"].removesuffix(".@derivative"): kind for p in panel.get("paths", ())}
        found |= dict.fromkeys(panel.get("topics", ()), "")
        found |= {panel[key]: "" for key in ("topicToRender",) if key in panel}
    return found


def _plotjuggler(described: Description) -> ElementTree.Element:
    return ElementTree.fromstring(layouts("1", described)["armrig.plotjuggler.xml"])


def snippets(described: Description = ARM) -> dict[str, ElementTree.Element]:
    """Return the functions of PlotJuggler's layout by the curve that each makes."""
    found = _plotjuggler(described).iter("snippet")
    return {snippet.attrib["name"]: snippet for snippet in found}


def plotjuggler_curves(described: Description = ARM) -> tuple[set[str], set[str]]:
    """Return the curves that PlotJuggler's layout draws, and what its functions are made of."""
    sources = {str(s.findtext("linked_source")) for s in snippets(described).values()}
    return {curve.attrib["name"] for curve in _plotjuggler(described).iter("curve")}, sources


def _descriptor(message: str, schema: bytes) -> Any:
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(schema).file:
        pool.Add(file)
    return pool.FindMessageTypeByName(message)


def kinds(topic: str, message: str, schema: bytes) -> Iterator[tuple[str, str]]:
    """Iterate over a topic and the fields of its messages, by a FileDescriptorSet."""
    yield topic, ""
    for field in _descriptor(message, schema).fields:
        text = field.type in (field.TYPE_STRING, field.TYPE_ENUM)
        if text or field.type not in (field.TYPE_MESSAGE, field.TYPE_BYTES):
            yield f"{topic}.{field.name}", "text" if text else "number"


def kinds_in_file(path: Path) -> Kinds:
    """Return the fields of an MCAP file, by its own schemas."""
    with path.open("rb") as file:
        summary: Any = make_reader(file).get_summary()
    found: Kinds = {}
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        found |= kinds(channel.topic, schema.name, schema.data)
    return found


@cache
def frames_class() -> Any:
    """Return the class of `foxglove.FrameTransforms` by the schema that foxglove-sdk has of it."""
    from foxglove.messages import FrameTransforms

    schema = FrameTransforms.get_schema()
    return message_factory.GetMessageClass(_descriptor(schema.name, schema.data))


def frame_angles(data: bytes) -> dict[tuple[str, str], float]:
    """Return how far each frame is turned about z, by its parent and its name."""
    found = {}
    for t in frames_class().FromString(data).transforms:
        assert (t.rotation.x, t.rotation.y) == (0.0, 0.0)
        assert (t.translation.x, t.translation.y) == (0.0, 0.0)
        angle = remainder(2 * atan2(t.rotation.z, t.rotation.w), tau)
        found[t.parent_frame_id, t.child_frame_id] = angle
    return found
