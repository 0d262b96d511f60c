"""Story of a schedule, tick by tick, for a person."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from armrig_daemon.decisions.state import Ordered, Received
from armrig_daemon.pipe import Run, Tagged
from armrig_protocol.decoder import feed

from tests.simulator.options import MS, Options
from tests.simulator.rig import Outcome, simulate

_LAST = 400
"""Lines before the end that are kept in full."""


def tell(options: Options, trace: Path | None = None) -> tuple[Outcome, list[str]]:
    """Return the outcome of a schedule, and its story; `trace` is for the pins of an Uno."""
    lines: list[str] = []

    def story(t_ns: int, what: str, thing: Any) -> None:
        lines.append(f"{t_ns / MS:11.3f} ms  {what:12} {_said(thing)}")

    outcome = simulate(options, story, trace)
    return outcome, lines


def write(options: Options, path: Path) -> Outcome:
    """Write the story of a schedule to `path`: its options, and its end in full.

    If the device is an Uno, also write a VCD of its pins.
    """
    outcome, lines = tell(options, path.with_suffix(".vcd") if options.uno else None)
    verdict = "no violation"
    if outcome.violation:
        invariant, t_ns, text = outcome.violation
        verdict = f"{invariant} is violated at {t_ns / MS:.3f} ms: {text}"
    frames = sum("sends" in line or "gets" in line for line in lines[:-_LAST])
    left_out = [f"… {frames} frames before are left out; what else happened:"] if frames else []
    before = [line for line in lines[:-_LAST] if "sends" not in line and "gets" not in line]
    told = [f"# Seed {options.seed}: {verdict}", "", *options.lines(), "", *left_out, *before]
    path.write_text("\n".join([*told, "", *lines[-_LAST:], verdict, ""]), encoding="utf-8")
    return outcome


def _said(thing: Any) -> str:
    if isinstance(thing, Received):
        return _said(thing.data)
    if isinstance(thing, bytes):
        _, messages = feed(b"", thing)
        return "; ".join(map(_short, messages)) or f"{len(thing)} bytes, no whole frame"
    if isinstance(thing, Ordered):
        return f"order {_short(thing.order)}"
    return _short(thing) if isinstance(thing, Tagged) else str(thing)


def _short(thing: Any) -> str:
    if isinstance(thing, Run):
        pace = "scheduled" if thing.scheduled else "by a law" if thing.law else "exchange"
        n = len(thing.codes) // 2 + len(thing.reference or b"") // 8
        return f"Run(order={thing.order}, n={thing.n}, {n} samples, {pace})"
    text = repr(thing)
    return text if len(text) < 160 else f"{text[:157]}..."
