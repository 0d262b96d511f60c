"""Traces of version 1 in today's words: their recordings are decided once more as any other.

A trace without a version is of version 1.
"""

from __future__ import annotations

import msgspec

from armrig_daemon.pipe import Orders

_TAGS = {"Take": "Arm", "Release": "Disarm", "Hold": "Set", "Play": "Run", "Halt": "Stop"}


def order_of(data: bytes) -> Orders:
    """Return an order of version 1 under its tag of today."""
    fields = msgspec.msgpack.decode(data)
    fields["type"] = _TAGS.get(fields["type"], fields["type"])
    order: Orders = msgspec.convert(fields, Orders)
    return order
