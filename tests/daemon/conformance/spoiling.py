"""Patches that make an emulated device break a rule."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import pytest
from armrig_daemon.emulator import requests, uart
from armrig_daemon.emulator.firmware import Firmware
from armrig_protocol.messages import Message

Patch = pytest.MonkeyPatch


class SpoiltDevice(NamedTuple):
    """A patch of the emulator, and the rule that must find it."""

    spoil: Callable[[Patch], None]
    found_by: str
    """Part of the rule's sentence."""


def other_handler(patch: Patch, kind: type[Message], make: Callable[[Any], Any]) -> None:
    """Replace the handler of a type by another."""
    patch.setitem(requests._HANDLERS, kind, make(requests._HANDLERS[kind]))


def any_value(patch: Patch, *, of: Sequence[type[Message]], name: str) -> None:
    """Let the device find its own value in a field of these requests, whatever it contains."""
    for kind in of:
        other_handler(
            patch,
            kind,
            lambda old: lambda fw, t, m: old(fw, t, m._replace(**{name: getattr(fw, name)})),
        )


def changed_answers(patch: Patch, change: Callable[[Message], Message | None]) -> None:
    """Let each frame to the host be another one, or none."""
    send = uart.Transmission.send

    def changed(self: uart.Transmission, fw: Firmware, t_ns: int, messages: list[Message]) -> None:
        kept = [new for m in messages if (new := change(m)) is not None]
        send(self, fw, t_ns, kept)

    patch.setattr(uart.Transmission, "send", changed)
