"""ARCHITECTURE.md shows the table of the requests to the device."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from armrig_daemon.decisions.request_table import REQUESTS, Row
from armrig_daemon.decisions.state import RequestKind
from armrig_protocol.messages import MESSAGES, State

PAGE = Path(__file__).parents[3] / "ARCHITECTURE.md"


def first_line(function: Callable[..., Any]) -> str:
    """Return the first line of a docstring as a cell, without the full stop."""
    return (function.__doc__ or "").partition("\n")[0].removesuffix(".")


def effect_shown_by(row: Row) -> str:
    """Return the reply, or the states of the device, by which the effect is seen."""
    if not isinstance(row.awaits, frozenset):
        return {"HelloReply": "HELLO_R", "ConfigReply": "CONFIG_R"}[row.awaits.__name__]
    unlike = [state.name for state in State if state not in row.awaits]
    named = [state.name for state in State if state in row.awaits]
    return named[0] if len(named) == 1 else f"a state other than {' and '.join(unlike)}"


def table() -> str:
    """Return the table of requests in Markdown."""
    lines = ["| request | effect is seen by | then | sent again | refused | without effect |"]
    lines.append("|---|---|---|---|---|---|")
    for kind, row in REQUESTS.items():
        tries = "no limit" if row.tries is None else f"at most {row.tries} times"
        cells = [
            kind.value,
            effect_shown_by(row),
            first_line(row.effect),
            f"after {row.retry_ns // 1_000_000} ms, {tries}",
            first_line(row.refusal),
            first_line(row.failure),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def test_the_table_of_architecture_equals_the_table_of_requests() -> None:
    """To draw the table again, put the text that this test expects into the page."""
    assert table() in PAGE.read_text(encoding="utf-8")


def test_each_request_has_a_row_and_a_message() -> None:
    assert [*REQUESTS] == [*RequestKind]
    assert {row.message for row in REQUESTS.values()} <= {*MESSAGES.values()}
