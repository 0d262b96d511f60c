"""The limit of open files."""

from __future__ import annotations

import os
import resource

import pytest
from armrig_core.process import open_files

from tests.core.test_process_limits import limit

INFINITE = resource.RLIM_INFINITY


@pytest.mark.parametrize(
    ("soft", "hard", "set_to"),
    [
        (1024, 1 << 20, [(16_384, 1 << 20)]),
        (1024, 4096, [(4096, 4096)]),
        (1024, INFINITE, [(16_384, INFINITE)]),
        (20_000, 1 << 20, []),
        (4096, 4096, []),
        (INFINITE, INFINITE, []),
    ],
)
def test_the_limit_is_raised_to_its_maximum_and_never_lowered(
    soft: int, hard: int, set_to: list[tuple[int, int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    given = limit(monkeypatch, files=(soft, hard))

    open_files.raise_limit()

    assert given == set_to


def test_open_files_are_counted_up_to_the_limit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before = open_files.count()
    pipes = [fd for _ in range(3) for fd in os.pipe()]
    assert open_files.count() == before + 6
    for fd in pipes:
        os.close(fd)
    assert open_files.count() == before

    def refuse(_: str) -> None:
        raise OSError

    limit(monkeypatch, files=(77, 99))
    monkeypatch.setattr(os, "scandir", refuse)
    assert open_files.count() == 77


def test_a_full_table_and_its_end_are_each_reported_once(monkeypatch: pytest.MonkeyPatch) -> None:
    limit(monkeypatch, files=(64, 64))
    found = iter([56, 57, 64, 56, 10])
    monkeypatch.setattr(open_files, "count", lambda: next(found))
    table = open_files.FullTable()

    lines = [table.look() for _ in range(5)]

    assert [line and line[0] for line in lines] == [None, "error", None, "info", None]
    assert lines[1] is not None
    assert lines[1][1].startswith("57 of 64 files are open: new clients cannot connect")


def test_a_table_without_a_limit_is_never_full(monkeypatch: pytest.MonkeyPatch) -> None:
    limit(monkeypatch, files=(INFINITE, INFINITE))

    assert open_files.FullTable().look() is None
