"""The suite: all rules of PROTOCOL.md that can be tested over a line, and their execution."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from textwrap import fill

from armrig_protocol import messages as wire
from armrig_protocol.messages import (
    FULL_SCALE_MV,
    QUEUE_CAPACITY,
    SCHEMA_HASH,
    SETPOINTS_PER_FRAME,
    VERSION,
    Capability,
    State,
)

from armrig_daemon.conformance import (
    byte_rules,
    configuration_rules,
    exchange_rules,
    guard_rules,
    load_rules,
    reading_rules,
    scheduled_rules,
    sequence_rules,
    state_rules,
)
from armrig_daemon.conformance.host import BOOT_MS, Broken, EndlessError, LineHost
from armrig_daemon.conformance.rule import NotTried, Result, Rule, expect, rule
from armrig_daemon.emulator.harness import CYCLES_PER_US, Violated, Violation

_MAX_TRIES = 6
_STALL_MS = 80
"""A failed rule is tested again if the host was silent for longer than this time, in ms."""
_MAX_SUITE_MS, _MAX_RECEIVED_BYTES = 600_000, 1 << 22
"""Limits of the whole suite, in ms and in B; an Uno needs 24 s, and sends 0.23 MB."""
PASS, FAIL, NOT_TRIED = "pass", "FAIL", "not tried"
_INDENT = " " * 14


@rule(3, "HELLO_R identifies the device: version, schema, full scale, and possible values")
def _hello(host: LineHost) -> None:
    it = host.known
    expect(
        (it.version, it.schema) == (VERSION, SCHEMA_HASH), f"version {it.version}, {it.schema:x}"
    )
    expect(it.full_scale_mv == FULL_SCALE_MV, f"full scale {it.full_scale_mv} mV")
    expect(it.boot_id != 0, "boot_id 0")
    expect(bool(it.capabilities & Capability.EXCHANGE), f"capabilities {it.capabilities:x}")
    expect(0 < it.hold_us < it.skew_us, f"hold_us {it.hold_us}, skew_us {it.skew_us}")
    # Both values are rounded up.
    expect(it.ts_min_us >= 2 * it.skew_us - 2, f"ts_min_us {it.ts_min_us}, skew_us {it.skew_us}")
    expect(8 <= it.adc_bits <= 16 and 1 <= it.pwm_bits <= 16, f"{it.adc_bits}, {it.pwm_bits} bits")
    if it.capabilities & Capability.SCHEDULED:
        fits = 2 * SETPOINTS_PER_FRAME <= it.queue <= QUEUE_CAPACITY
        expect(fits, f"a queue of {it.queue}")


@rule(1, "The device's frames are valid, and seq increases by 1 from frame to frame")
def _sender(host: LineHost) -> None:
    expect(host.spoilt == 0, f"{host.spoilt} of the device's frames were spoilt")
    expect(host.breaks == 0, f"{host.breaks} breaks in the device's seq")


_MODULES = (
    byte_rules,
    sequence_rules,
    state_rules,
    configuration_rules,
    exchange_rules,
    reading_rules,
    scheduled_rules,
    guard_rules,
    load_rules,
)
RULES: tuple[Rule, ...] = (
    _hello,
    *(value for module in _MODULES for value in vars(module).values() if isinstance(value, Rule)),
    _sender,  # last, because it is about all frames of the session
)


def run(
    host: LineHost, report: Callable[[Result], None], wanted: Sequence[Rule] = RULES
) -> list[Result]:
    """Test each rule and return the results; at the end the device is at 0 V in every case.

    A device that floods the line, or answers for minutes, breaks the current rule. The later rules
    are then not tested.

    The rules in `wanted` are tested in order. `report` is called with each result as soon as its
    rule has been tested.

    Raises Broken if the device does not answer HELLO.
    """
    results: list[Result] = []
    left = iter(wanted)
    host.limit(_MAX_SUITE_MS, _MAX_RECEIVED_BYTES)

    def add(result: Result) -> None:
        results.append(result)
        report(result)

    try:
        host.hello(BOOT_MS)
        for pending in left:
            try:
                add(_test_rule(host, pending))
            except EndlessError as err:
                add(Result(pending.section, pending.sentence, FAIL, str(err)))
                break
        for pending in left:
            add(Result(pending.section, pending.sentence, NOT_TRIED, "the suite had ended before"))
    except EndlessError as err:
        raise Broken(str(err)) from err
    finally:
        host.limit()
        leave(host)
    return results


def _test_rule(host: LineHost, tested_rule: Rule) -> Result:
    """Test a rule; if the test failed and the host stalled during the test, repeat the test."""
    behaviour, outcome = "", FAIL
    for _ in range(_MAX_TRIES):
        try:
            host.to_idle()
            host.silence_ms = 0.0
            tested_rule.check(host)
        except Broken as err:
            behaviour = str(err)
            host.note_silence()
            if tested_rule.silent or host.silence_ms > _STALL_MS:
                continue
        except NotTried as err:
            outcome, behaviour = NOT_TRIED, str(err)
        else:
            outcome, behaviour = PASS, ""
        break
    return Result(tested_rule.section, tested_rule.sentence, outcome, behaviour)


def leave(host: LineHost) -> None:
    """Leave the device at 0 V: send STOP, and ESTOP if STOP is not confirmed."""
    for kind in (wire.Stop, wire.Estop):
        with suppress(
            Broken, OSError
        ):  # if the port is gone, the device's watchdog stops the motor
            for _ in range(3):
                host.put(kind)
            host.fence()
            if host.state not in (State.ARMED, State.RUN):
                return


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


def json_of(facts: wire.HelloReply | None, results: Sequence[Result]) -> dict[str, object]:
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


def pin_rules(violations: Sequence[Violated]) -> tuple[Rule, ...]:
    """Return the rules about a board's pins; they must be tested after all other rules."""

    def pins(section: int, sentence: str, *kinds: Violation) -> Rule:
        @rule(section, f"At the pins: {sentence}")
        def check(host: LineHost) -> None:
            host.fence()
            seen = [v for v in violations if v.what in kinds]
            ms = seen[0].cycle / CYCLES_PER_US / 1000 if seen else 0.0
            occurrences = f"{len(seen)} times, first {ms:.2f} ms after power-on"
            expect(not seen, f"{seen[0].what.sentence}: {occurrences}" if seen else "")

        return check

    return (
        pins(
            7,
            "outside RUN, the motor's pin and the enable line are low, from the reset on",
            Violation.PIN_HIGH_WITHOUT_ENABLE,
            Violation.DRIVEN_OUTSIDE_RUN,
        ),
        pins(
            5,
            "in RUN, the motor's pin has the code that SAMPLE reports",
            Violation.CODE_NOT_AT_PIN,
        ),
        pins(
            1,
            "the program does not stop, and the transmitter is not overwritten",
            Violation.CPU_STOPPED,
            Violation.TX_OVERRUN,
        ),
    )
