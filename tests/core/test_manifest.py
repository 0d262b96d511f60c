"""The record of a run, and what of it is due."""

from __future__ import annotations

from typing import Any

import pytest
from armrig_core.manifest import (
    Manifest,
    Recovered,
    check_whole_numbers,
    manifest_of,
    recovered_of,
)

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
def test_from_its_first_sample_on_a_file_lacks_what_is_due(
    fields: dict[str, int], due: range
) -> None:
    assert Manifest(**MADE, **fields).due == due


def test_a_manifest_is_read_as_it_was_written() -> None:
    made = Manifest(**MADE, details={"a": [1, {"b": None}]}, host={"port": "unix:/x"}, part=3)

    assert manifest_of(made.metadata()) == made
    assert made.emulated
    assert not Manifest(**MADE, device={"uid": "17"}, host={"port": "/dev/a"}).emulated
    fixed = Recovered(when="w", armrig="0.2.0", kept_bytes=5, cut_off_bytes=7, damage="d")
    assert recovered_of(fixed.metadata()) == fixed


@pytest.mark.parametrize(
    ("number", "fits"), [(2**63 - 1, True), (2**63, False), (-(2**63), True), (-(2**63) - 1, False)]
)
def test_a_whole_number_has_64_bit(number: int, fits: bool) -> None:
    made = Manifest(**{**MADE, "clock_offset_ns": number})

    if fits:
        check_whole_numbers(made)
        return
    with pytest.raises(ValueError, match="clock_offset_ns does not fit into 64 bit"):
        check_whole_numbers(made)


@pytest.mark.parametrize(("levels", "fits"), [(31, True), (32, False)])
def test_a_value_has_at_most_32_levels(levels: int, fits: bool) -> None:
    value: Any = 1
    for level in range(levels):
        value = [value] if level % 2 else {"x": value}
    made = Manifest(**MADE, host={"port": "/dev/a"}, details={"seed": value})

    if fits:
        check_whole_numbers(made)
        return
    with pytest.raises(ValueError, match="details is nested more than 32 levels deep"):
        check_whole_numbers(made)
