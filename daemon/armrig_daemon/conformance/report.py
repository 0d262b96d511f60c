"""Results of the suite, as text and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill

from armrig_protocol.messages import HelloReply

from armrig_daemon.conformance.rule import Result
from armrig_daemon.conformance.suite import FAIL, NOT_TRIED, PASS

_INDENT = " " * 14


def line_of(result: Result, columns: int = 0) -> str:
    """Return a result as text: rule and device's behaviour; `columns` > 0 is the largest width."""
    lines = [f"{result.outcome:9}  {result.section}  {result.sentence}"]
    if result.came:
        lines.append(f"{_INDENT}{'came: ' if result.outcome == FAIL else ''}{result.came}")
    if columns:
        lines = [fill(line, columns, subsequent_indent=_INDENT) for line in lines]
    return "\n".join(lines)


def sum_of(results: Sequence[Result]) -> str:
    """Return the summary of all results as a line."""
    n = {outcome: sum(r.outcome == outcome for r in results) for outcome in (PASS, FAIL, NOT_TRIED)}
    verdict = (
        f"{n[FAIL]} of {len(results)} rules are broken"
        if n[FAIL]
        else f"all {n[PASS]} tested rules hold"
    )
    return f"{verdict}; {n[NOT_TRIED]} not tried"


def json_of(facts: HelloReply | None, results: Sequence[Result]) -> dict[str, object]:
    """Return all results as JSON for a program: the device's HELLO_R and each rule."""
    device = {} if facts is None else {k: v for k, v in facts._asdict().items() if k != "seq"}
    for name in ("uid", "boot_id", "schema", "firmware"):
        if name in device:
            device[name] = f"{device[name]:x}"
    return {
        "device": device,
        "rules": [r._asdict() for r in results],
        "broken": sum(r.outcome == FAIL for r in results),
    }
