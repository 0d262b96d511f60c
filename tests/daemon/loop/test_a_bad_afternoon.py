"""All reports of a loop at an odd rig in a bad afternoon; they are in `a_bad_afternoon.txt`."""

from __future__ import annotations

from pathlib import Path

from tests.clients.said import compare
from tests.daemon.odd_bench import afternoon


def test_the_records_of_repeated_faults_equal_the_stored_records() -> None:
    lines = afternoon()

    compare(Path(__file__).with_name("a_bad_afternoon.txt"), "\n".join(lines) + "\n")
