"""All that a loop tells of an odd rig in a bad afternoon; it is in `a_bad_afternoon.txt`."""

from __future__ import annotations

from pathlib import Path

from odd_bench import afternoon
from said import compare


def test_what_is_told_of_a_bad_afternoon_is_what_was_told() -> None:
    """States, answers, gaps, runs, seconds' timing and the clock; of the samples some."""
    lines = afternoon()

    compare(Path(__file__).with_name("a_bad_afternoon.txt"), "\n".join(lines) + "\n")
