"""Conversion of traces of version 1 to the current names, for a replay.

A trace without a version is of version 1.
"""

from __future__ import annotations

import msgspec

from armrig_daemon.decisions.state import Clock, Configuration, Link, State
from armrig_daemon.pipe import Orders

_TAGS = {"Take": "Arm", "Release": "Disarm", "Hold": "Set", "Play": "Run", "Halt": "Stop"}


_PARTS = {"link": Link, "configuration": Configuration, "clock": Clock}


def state_of(data: bytes) -> State:
    """Return the state in a trace of version 1, where all fields are in one table.

    Each state in a trace belongs to a run, and therefore has a link.
    """
    fields = msgspec.msgpack.decode(data)
    fields["map"] = fields.pop("clock")
    rules = fields["rules"]
    rules["code_min"], rules["code_max"] = rules.pop("u_min"), rules.pop("u_max")
    parts = {
        name: {key: fields[key] for key in kind.__struct_encode_fields__ if key in fields}
        for name, kind in _PARTS.items()
    }
    return msgspec.convert(fields | parts, State)


def order_of(data: bytes) -> Orders:
    """Decode an order in a trace of version 1, and give its type the current name."""
    fields = msgspec.msgpack.decode(data)
    fields["type"] = _TAGS.get(fields["type"], fields["type"])
    order: Orders = msgspec.convert(fields, Orders)
    return order
