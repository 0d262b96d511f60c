"""Ctrl-C while a program loads."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import pytest
from armrig_core.process.loading import end_at_ctrl_c, is_interrupt


@pytest.fixture(autouse=True)
def handler() -> Iterator[None]:
    """Restore the handler of the tests."""
    before = signal.getsignal(signal.SIGINT)
    yield
    signal.signal(signal.SIGINT, before)


def test_ctrl_c_ends_a_starting_program_with_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[object] = []
    monkeypatch.setattr(os, "write", lambda fd, text: done.append((fd, text)))
    monkeypatch.setattr(os, "_exit", done.append)
    signal.signal(signal.SIGINT, signal.default_int_handler)

    has_loaded = end_at_ctrl_c("armrigd")
    try:
        signal.raise_signal(signal.SIGINT)
    except KeyboardInterrupt:
        pytest.fail("the module that loads is interrupted")
    has_loaded()

    assert done == [(2, b"armrigd: interrupted\n"), 130]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_ignored_ctrl_c_stays_ignored() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    has_loaded = end_at_ctrl_c("armrigd")
    signal.raise_signal(signal.SIGINT)
    during = signal.getsignal(signal.SIGINT)
    has_loaded()

    assert during == signal.getsignal(signal.SIGINT) == signal.SIG_IGN


def test_an_error_caused_by_ctrl_c_is_reported_as_an_interrupt() -> None:
    caused = RuntimeError("import failed")
    caused.__cause__ = KeyboardInterrupt()
    other = RuntimeError("import failed")
    other.__cause__ = ValueError()

    errors = (KeyboardInterrupt(), caused, other, RuntimeError())
    assert [is_interrupt(err) for err in errors] == [True, True, False, False]
