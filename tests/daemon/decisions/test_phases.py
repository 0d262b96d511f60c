"""The ways from phase to phase are one table, and docs/safety.md draws it."""

from __future__ import annotations

from pathlib import Path

import pytest
from armrig_daemon.decisions.phases import TRANSITIONS, On, change_phase
from armrig_daemon.decisions.state import Phase
from msgspec.structs import replace

from tests.daemon.decision_states import rested

PAGE = Path(__file__).parents[3] / "docs" / "safety.md"


def diagram() -> str:
    """Return the table as a Mermaid diagram; an unchanged phase has no arrow."""
    arrows = [
        f"    {before} --> {after}: {on.value}"
        for on, ways in TRANSITIONS.items()
        for before, after in ways.items()
        if before is not after
    ]
    return "\n".join(["```mermaid", "stateDiagram-v2", "    [*] --> init", *arrows, "```"])


def test_the_diagram_of_the_page_equals_the_table_of_phases() -> None:
    """To draw the table again, put the text that this test expects into the page."""
    assert diagram() in PAGE.read_text(encoding="utf-8")


def test_only_a_reset_leaves_a_fault() -> None:
    """S6: a trip latches, and only `safe` can be armed."""
    out = {on for on, ways in TRANSITIONS.items() if ways.get(Phase.FAULT, Phase.FAULT) != "fault"}

    assert out == {On.RESET}
    assert TRANSITIONS[On.RESET] == {Phase.FAULT: Phase.SAFE}
    assert {*TRANSITIONS[On.ARMED]} == {Phase.SAFE}
    assert {*TRANSITIONS[On.STARTED]} == {Phase.ARMED}


def test_transition_outside_the_table_raises() -> None:
    latched = replace(rested().loop.state, phase=Phase.FAULT)

    with pytest.raises(KeyError):
        change_phase(latched, On.ARMED)
