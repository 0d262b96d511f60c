"""Traces of version 1 in today's words: their recordings are decided once more as any other.

A trace without a version is of version 1.
"""

from __future__ import annotations

import msgspec

from armrig_daemon.decisions.state import Clock, Configuration, Link, State
from armrig_daemon.pipe import Orders

_TAGS = {"Take": "Arm", "Release": "Disarm", "Hold": "Set", "Play": "Run", "Halt": "Stop"}


_PARTS = {"link": Link, "configuration": Configuration, "clock": Clock}


def state_of(data: bytes) -> State:
    """Return a state of version 1, in which all fields stood in one; of a run there is a link."""
    fields = msgspec.msgpack.decode(data)
    fields["map"] = fields.pop("clock")
    rules = fields["rules"]
    rules["code_min"], rules["code_max"] = rules.pop("u_min"), rules.pop("u_max")
    parts = {
        name: {field: fields[field] for field in kind.__struct_fields__ if field in fields}
        for name, kind in _PARTS.items()
    }
    return msgspec.convert(fields | parts, State)


def order_of(data: bytes) -> Orders:
    """Return an order of version 1 under its tag of today."""
    fields = msgspec.msgpack.decode(data)
    fields["type"] = _TAGS.get(fields["type"], fields["type"])
    order: Orders = msgspec.convert(fields, Orders)
    return order
