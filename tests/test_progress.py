"""The output of `make test` about a run and its skipped tests."""

from __future__ import annotations

import pytest

from tests.progress import MAX_REASONS, grouped, room


@pytest.mark.parametrize(
    ("nodeid", "expected"),
    [
        ("tests/clients/physics/integrators/test_exact.py::test_a[x/y::z]", "clients/physics"),
        ("tests/integration/test_service.py::test_a", "integration"),
        ("tests/test_progress.py::test_a", ""),
    ],
)
def test_a_test_belongs_to_the_room_of_its_folder(nodeid: str, expected: str) -> None:
    assert room(nodeid) == expected


def test_skipped_tests_are_grouped_by_reason_in_at_most_ten_lines() -> None:
    reasons = [f"no tool {i}" for i in range(14) for _ in range(i + 1)]

    lines = grouped(reasons)

    assert len(lines) == MAX_REASONS
    assert lines[0] == "  14 skipped, no tool 13"
    assert lines[-1] == "  15 skipped, 5 other reasons: pytest -rs"
    assert sum(int(line.split()[0]) for line in lines) == len(reasons)


def test_ten_reasons_are_all_shown() -> None:
    lines = grouped(f"no tool {i}" for i in range(MAX_REASONS))

    assert lines == [f"   1 skipped, no tool {i}" for i in range(MAX_REASONS)]
