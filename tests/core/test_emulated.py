"""Recordings of an emulated rig."""

from __future__ import annotations

import pytest
from armrig_core.emulated import is_emulated


@pytest.mark.parametrize(
    ("uid", "port", "emulated"),
    [
        ("726f74616c756d65", "/dev/pts/3", True),
        ("a5b1c2d3e4f50617", "unix:/run/user/0/armrig/1.line", True),
        ("a5b1c2d3e4f50617", "emulated", True),
        ("a5b1c2d3e4f50617", "/dev/ttyACM0", False),
        ("", "", False),
    ],
)
def test_a_rig_is_emulated_by_its_device_or_its_port(uid: str, port: str, emulated: bool) -> None:
    """The simulated Uno draws an identity of its own, so the port decides."""
    assert is_emulated(uid=uid, port=port) is emulated
