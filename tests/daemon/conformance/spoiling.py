"""Patches that make an emulated device break a rule."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
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


class SpoiltDevices(dict[str, SpoiltDevice]):
    """Spoilt devices by the way in which each is spoilt."""

    def add(self, how: str, found_by: str, spoil: Callable[..., None], *arguments: Any) -> None:
        """Add a device that `spoil` makes, called with a patch and the arguments."""
        self[how] = SpoiltDevice(lambda patch: spoil(patch, *arguments), found_by)

    def function(self, how: str, found_by: str, owner: Any, name: str) -> Callable[[Any], Any]:
        """Replace a function by the decorated one, whose first argument is the replaced one."""

        def decorated(function: Any) -> Any:
            self.add(how, found_by, other_function, owner, name, function)
            return function

        return decorated

    def handler(self, how: str, found_by: str, kind: type[Message]) -> Callable[[Any], Any]:
        """Replace the handler of a type, as `function` does."""

        def decorated(handler: Any) -> Any:
            self.add(how, found_by, other_handler, kind, lambda old: partial(handler, old))
            return handler

        return decorated

    def answer(
        self,
        how: str,
        found_by: str,
        kind: type[Message],
        change: Callable[[Any], dict[str, int]],
        when: Callable[[Any], object] = lambda m: True,
    ) -> None:
        """Change fields of the device's messages of a type, if `when` is true."""

        def send(old: Any, wire: Any, fw: Firmware, t_ns: int, messages: list[Message]) -> None:
            changed = [
                m._replace(**change(m)) if isinstance(m, kind) and when(m) else m for m in messages
            ]
            old(wire, fw, t_ns, changed)

        self.add(how, found_by, other_function, uart.Transmission, "send", send)


def other_function(patch: Patch, owner: Any, name: str, function: Callable[..., Any]) -> None:
    """Replace a function by another, whose first argument is the replaced one."""
    old = getattr(owner, name)
    patch.setattr(owner, name, lambda *args, **options: function(old, *args, **options))


def other_handler(patch: Patch, kind: type[Message], make: Callable[[Any], Any]) -> None:
    """Replace the handler of a type by another."""
    patch.setitem(requests._HANDLERS, kind, make(requests._HANDLERS[kind]))


def any_value(patch: Patch, name: str, *kinds: type[Message]) -> None:
    """Let the device find its own value in a field of these requests, whatever it contains."""
    for kind in kinds:
        other_handler(
            patch,
            kind,
            lambda old: lambda fw, t, m: old(fw, t, m._replace(**{name: getattr(fw, name)})),
        )
