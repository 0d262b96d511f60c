"""The evaluation of the golden vectors, without pytest, so that any Python can run it.

`PYTHONPATH=firmware_protocol:daemon python -m tests.core.control.golden` needs msgspec only.
"""

from __future__ import annotations

import json
import sys
from math import isfinite, nan
from pathlib import Path
from typing import Any

from armrig_core.control.evaluation import Latch, LawState, Program, begin, decide, observe
from armrig_core.control.monitor import MonitorProgram, alarm, find_lost_output
from msgspec.structs import asdict

VECTORS = Path(__file__).with_name("vectors.json")


def cases() -> list[dict[str, Any]]:
    """Return the stored cases; a float has the same bits as when it was written."""
    return [dict(case) for case in json.loads(VECTORS.read_text())]


def differences(case: dict[str, Any]) -> list[str]:
    """Return what the evaluation of a case computes otherwise than its vector says."""
    law, latch, r = program_of(case["law"]), Latch(**case["rig"]), case["reference"]
    state, pairs = begin(law), []
    for event in case["events"]:
        if "observe" in event:
            values = [nan if value is None else value for value in event["values"]]
            state = observe(law, state, event["observe"], values, r, latch)
            if law.monitor:
                pairs.append((event, {**event, "alarm": alarm_of(law, state)}))
            continue
        state, command = decide(law, state, event["decide"], r, latch)
        flags = [command.is_low, command.is_high, command.is_slewed]
        v = command.v if isfinite(command.v) else None
        computed = {"v": v, "code": command.code, "flags": flags, "predicted": command.predicted}
        pairs.append((event, {"decide": event["decide"], **computed}))
    pairs.append((case["end"], end_of(law, state)))
    return [f"{expected}: {computed}" for expected, computed in pairs if expected != computed]


def end_of(law: Program, state: LawState) -> dict[str, Any]:
    """Return the state after the run, as the vectors have it."""
    counts = {"blind": state.blind, "astray": state.astray, "limited": state.limited}
    end = {"k": state.k, "x": [*state.x], "y": [*state.y], "zeros": [*state.zeros], **counts}
    return end | ({"monitor": monitor_of(law, state)} if law.monitor else {})


def alarm_of(law: Program, state: LawState) -> list[Any] | None:
    """Return the gate that has tripped, and the number of its output."""
    found = alarm(law.monitor, state.monitor) if law.monitor and state.monitor else None
    return found and [found.gate, found.output]


def lost_of(law: Program, state: LawState) -> str:
    """Return the output that has had no valid value for too long."""
    return find_lost_output(law.monitor, state.monitor) if law.monitor and state.monitor else ""


def monitor_of(law: Program, state: LawState) -> dict[str, Any]:
    """Return the state of the monitor; a number that may be infinite is a text."""
    fields: dict[str, Any] = {key: [*row] for key, row in asdict(state.monitor).items()}
    texts = {key: [*map(repr, fields[key])] for key in ("x", "simulated", "low", "high")}
    counts = {"innovation": fields["unlike"], "simulation": fields["astray"]}
    return {
        **texts,
        "zeros": fields["zeros"],
        **counts,
        "alarm": alarm_of(law, state),
        "lost": lost_of(law, state),
    }


def program_of(law: dict[str, Any]) -> Program:
    """Return the law of a case as the core evaluates it."""
    fields = {name: _tuples(value) for name, value in law.items()}
    rows = tuple((*a, *b) for a, b in zip(fields.pop("A"), fields.pop("B"), strict=True))
    v_row = (*fields.pop("C"), fields.pop("D"))
    monitor = fields.pop("monitor", None)
    bounds = {"most_blind": 100, "most_limited": 0, "most_astray": 100}
    return Program(
        law_sha256="",
        Ts_us=10_000,
        rows=rows,
        v_row=v_row,
        predictions=fields.pop("F"),
        monitor=monitor and monitor_program(monitor),
        **fields,
        **bounds,
    )


def monitor_program(monitor: dict[str, Any]) -> MonitorProgram:
    """Return the monitor of a case as the core evaluates it."""
    fields = {name: _tuples(value) for name, value in monitor.items()}
    sides = zip(fields.pop("A"), fields.pop("B"), fields.pop("L"), strict=True)
    return MonitorProgram(
        outputs=("first", "second"),
        rows=tuple((*a, b, *gains) for a, b, gains in sides),
        predictions=fields.pop("C"),
        **fields,
    )


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


if __name__ == "__main__":
    found = [f"{case['name']}: {line}" for case in cases() for line in differences(case)]
    sys.exit("\n".join(found) or 0)
