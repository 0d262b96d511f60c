"""The record of a run, and what of it is due."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

import pytest
from armrig_core.recording_file.manifest import (
    Manifest,
    Recovered,
    check_whole_numbers,
)
from armrig_core.rig.emulated import is_emulated

MADE: dict[str, Any] = {
    "rig": "lab-2",
    "run_id": "r",
    "experiment": "odd",
    "Ts": 0.02,
    "samples": 30,
    "started": "2026-11-20T08:59:07+01:00",
    "clock_offset_ns": -5,
    "armrig": "0.2.0",
    "protocol": "2 f7128a84",
}


@pytest.mark.parametrize(
    ("fields", "due"),
    [
        ({"k_first": 7}, range(7, 37)),
        ({"k_first": 7, "part": 1, "part_k_first": 7}, range(7, 37)),
        ({"k_first": 7, "part": 2, "part_k_first": 20}, range(20, 37)),
        ({"k_first": 7, "part": 2, "part_k_first": -1}, range(37)),
        ({"k_first": 0}, range(30)),
        ({}, range(1 << 62)),
        ({"k_first": (1 << 62) - 3}, range((1 << 62) - 3, 1 << 62)),
    ],
)
def test_the_manifest_determines_which_samples_of_a_file_are_due(
    fields: dict[str, int], due: range
) -> None:
    assert Manifest(**MADE, **fields).due == due


def test_a_manifest_is_read_as_it_was_written() -> None:
    made = Manifest(**MADE, details={"a": [1, {"b": None}]}, host={"port": "unix:/x"}, part=3)

    assert Manifest.of(made.metadata()) == made
    assert made.emulated
    assert not Manifest(**MADE, device={"uid": "17"}, host={"port": "/dev/a"}).emulated
    fixed = Recovered(when="w", armrig="0.2.0", kept_bytes=5, cut_off_bytes=7, damage="d")
    assert Recovered.of(fixed.metadata()) == fixed


def _nested(levels: int) -> Any:
    value: Any = 1
    for level in range(levels):
        value = [value] if level % 2 else {"x": value}
    return {"seed": value}


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"clock_offset_ns": 2**63 - 1}, ""),
        ({"clock_offset_ns": 2**63}, "clock_offset_ns does not fit into 64 bit"),
        ({"clock_offset_ns": -(2**63)}, ""),
        ({"clock_offset_ns": -(2**63) - 1}, "clock_offset_ns does not fit into 64 bit"),
        ({"details": _nested(31), "host": {"port": "/dev/a"}}, ""),
        ({"details": _nested(32)}, "details is nested more than 32 levels deep"),
    ],
)
def test_integers_have_64_bit_and_values_at_most_32_levels(
    fields: dict[str, Any], says: str
) -> None:
    made = Manifest(**{**MADE, **fields})

    with pytest.raises(ValueError, match=says) if says else nullcontext():
        check_whole_numbers(made)


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
def test_the_device_or_the_port_shows_that_a_rig_is_emulated(
    uid: str, port: str, emulated: bool
) -> None:
    """The simulated Uno draws an identity of its own, so the port decides."""
    assert is_emulated(uid=uid, port=port) is emulated
