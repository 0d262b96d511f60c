"""The conformance suite passes a device that obeys PROTOCOL.md, and no other."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from hashlib import blake2b
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from armrig_daemon.conformance.host import BOOT_MS, Broken, EndlessError, LineHost
from armrig_daemon.conformance.line import VirtualLine
from armrig_daemon.conformance.rule import Result, Rule
from armrig_daemon.conformance.suite import FAIL, NOT_TRIED, PASS, RULES, leave, pin_rules, run
from armrig_daemon.emulator import converter
from armrig_daemon.emulator.device import Device
from armrig_daemon.emulator.firmware import Firmware
from armrig_daemon.emulator.harness import Violated, Violation
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_protocol.decoder import feed
from armrig_protocol.frame import encode
from armrig_protocol.messages import Ack, Capability, Ping, Pong, Sample, Start, State, Stop

from tests.daemon.conformance.spoiling import other_handler
from tests.daemon.conformance.spoilt_devices import AT_A_RAIL, SPOILT, UNPLUGGED

UNO = {"queue": 256}
SPOILT_SETTINGS = EmulatorSettings(boot_ms=5.0, **AT_A_RAIL)
STORED = Path(__file__).with_name("results.txt")
"""Frames of each rule, and the finding of the rule that a spoilt device breaks."""
SPOILT_DEVICES = "spoilt devices"


def tried(
    settings: EmulatorSettings, *, resets: bool = True, wanted: Sequence[Rule] = RULES
) -> list[Result]:
    """Return what becomes of the rules; the device is left at 0 V."""
    device = Device(settings, 0)
    told: list[Result] = []
    results = run(LineHost(VirtualLine(device, resets=resets), settings.baud), told.append, wanted)
    assert device.state is not State.RUN
    assert device.board.volts == 0.0
    assert results == told
    return results


@pytest.mark.parametrize(
    ("settings", "resets"),
    [
        ({}, True),
        (UNO | {"baud": 115_200}, False),
        ({"baud": 1_000_000, "pwm_bits": 0, "adc_bits": 0}, True),
        (AT_A_RAIL, False),
    ],
    ids=str,
)
def test_the_emulated_device_passes_all_rules_of_the_protocol(
    settings: dict[str, float], resets: bool
) -> None:
    emulated = EmulatorSettings(boot_ms=5.0, **{**UNPLUGGED, **settings})

    results = tried(emulated, resets=resets)

    assert [r for r in results if r.outcome == FAIL] == []
    not_tried = [r.sentence.split()[0] for r in results if r.outcome == NOT_TRIED]
    assert not_tried == ["If"] * (not resets) + ["`rail_ticks`"] * (settings is not AT_A_RAIL)
    assert len(results) == len(RULES)


@pytest.mark.parametrize("how", SPOILT)
def test_a_device_that_breaks_a_rule_fails_it(how: str, monkeypatch: pytest.MonkeyPatch) -> None:
    spoilt = SPOILT[how]
    spoilt.spoil(monkeypatch)

    results = tried(SPOILT_SETTINGS, wanted=[r for r in RULES if spoilt.found_by in r.sentence])

    broken = [" ".join(r.came.split()) for r in results if r.outcome == FAIL]
    compare(SPOILT_DEVICES, [f"{how}: {came}" for came in broken], f"{how}: ")
    assert broken


@pytest.mark.parametrize("inside", [0, 1, 3, 4])
def test_a_reading_may_reach_the_rail_during_the_run(
    inside: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A potentiometer near its dead band reads so after the motor has moved it."""
    plain = converter.sample

    def sample(fw: Firmware, now_ns: int, t_us: int, y0: int, y1: int, *, late: bool) -> Any:
        return plain(fw, now_ns, t_us, 32_768 if fw.pending[0].k <= inside else y0, y1, late=late)

    monkeypatch.setattr(converter, "sample", sample)

    [result] = tried(
        SPOILT_SETTINGS, wanted=[r for r in RULES if r.sentence.startswith("`rail_ticks`")]
    )

    assert (result.outcome, result.came) == (PASS, "")


def test_each_rule_sends_the_stored_frames() -> None:
    device = Device(EmulatorSettings(boot_ms=5.0, queue=200, baud=250_000, **AT_A_RAIL), 0)
    line, lines = Recorded(device), list[str]()

    def note(result: Result) -> None:
        sent = b"".join(line.sent)
        line.sent.clear()
        kinds = Counter(
            type(m).__name__ if isinstance(m, tuple) else "no frame" for m in feed(b"", sent)[1]
        )
        counted = ", ".join(f"{n} {kind}" for kind, n in sorted(kinds.items()))
        head = f"{result.section} {result.sentence[:60]}: {result.outcome}"
        lines.append(f"{head}: {counted}; {len(sent)} B, {_sum(sent)}")

    run(LineHost(line, 250_000), note)

    compare("all rules", lines)


class Recorded(VirtualLine):
    """Keeps the sent frames."""

    def __init__(self, device: Device) -> None:
        super().__init__(device)
        self.sent: list[bytes] = []

    def send(self, data: bytes) -> None:
        """Put bytes on the wire."""
        self.sent.append(data)
        super().send(data)


def _sum(data: bytes) -> str:
    # Not the CRC-32 of the frames themselves: that of a frame with its CRC is always the same.
    return blake2b(data, digest_size=4).hexdigest()


def compare(part: str, found: list[str], begin: str = "") -> None:
    """Compare lines with those of a stored part that begin so; or store them (`WRITE_STORED`)."""
    text = STORED.read_text().removeprefix("# ")
    parts = {
        name: lines.split("\n") for name, lines in (p.split("\n", 1) for p in text.split("\n# "))
    }
    lines = [line for line in parts[part] if line]
    if os.environ.get("WRITE_STORED"):
        parts[part] = [line for line in lines if not line.startswith(begin)] + found
        STORED.write_text("".join(f"# {name}\n" + "\n".join(parts[name]) + "\n" for name in parts))
    else:
        stored = [line for line in lines if line.startswith(begin)]
        assert found == stored, "if it is to be so: make stored"


@pytest.mark.parametrize("deaf", [False, True])
@pytest.mark.parametrize("state", [State.ARMED, State.RUN])
def test_a_device_is_left_neither_armed_nor_in_run(
    state: State, deaf: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = EmulatorSettings(boot_ms=5.0)
    device = Device(settings, 0)
    host = LineHost(VirtualLine(device), settings.baud)
    host.hello(BOOT_MS)
    host.reach(state)
    if deaf:
        other_handler(monkeypatch, Stop, lambda _: lambda *_: [])

    leave(host)

    assert device.state is (State.ESTOP if deaf else State.IDLE)


class Flooded(VirtualLine):
    """From the first START on, one piece comes again and again, and nothing else."""

    def __init__(self, piece: bytes, every_ms: float) -> None:
        super().__init__(Device(EmulatorSettings(boot_ms=5.0), 0))
        self._piece, self._every_ns = piece, round(every_ms * 1e6)
        self._floods = False

    def send(self, data: bytes) -> None:
        """Take note of a START."""
        super().send(data)
        self._floods |= any(isinstance(m, Start) for m in feed(b"", data)[1])

    def receive(self, within_ms: float) -> bytes:
        if not self._floods:
            return super().receive(within_ms)
        self._now_ns += self._every_ns
        return self._piece


@pytest.mark.parametrize(
    ("piece", "every_ms", "says"),
    [
        (b"\x55" * (1 << 18), 1.0, "sent more than the whole suite allows"),
        (encode(Sample(State.RUN, *[0] * 12)), 100.0, "took longer than"),
    ],
    ids=["bytes", "samples"],
)
def test_a_device_that_floods_the_line_breaks_the_rule_that_is_tried(
    piece: bytes, every_ms: float, says: str
) -> None:
    line = Flooded(piece, every_ms)
    at = next(n for n, rule in enumerate(RULES) if "At 1 kHz" in rule.sentence)

    results = run(LineHost(line), lambda _: None, [RULES[0], *RULES[at : at + 2]])

    assert [r.outcome for r in results] == [PASS, FAIL, NOT_TRIED]
    assert says in results[1].came
    line.device.advance(line.now_ns() + 100_000_000)
    assert line.device.state is State.ESTOP


def test_violations_at_the_pins_are_counted_with_the_time_of_the_first() -> None:
    high, stopped = Violation.PIN_HIGH_WITHOUT_ENABLE, Violation.CPU_STOPPED
    seen = [Violated(n * 16_000, what) for n, what in ((20, high), (30, stopped), (45, high))]
    host = LineHost(VirtualLine(Device(SPOILT_SETTINGS, 0)))

    low, code, runs = run(host, lambda _: None, pin_rules(seen))

    assert low.came == f"{high.sentence}: 2 times, first 20.00 ms after power-on"
    assert runs.came == f"{stopped.sentence}: 1 times, first 30.00 ms after power-on"
    assert [r.outcome for r in (low, code, runs)] == [FAIL, PASS, FAIL]


@pytest.mark.parametrize("resets", [True, False])
def test_bytes_on_the_line_while_the_port_is_closed_are_lost(resets: bool) -> None:
    device = Device(EmulatorSettings(boot_ms=5.0), 0)
    line = VirtualLine(device, resets=resets)
    line.receive(10)
    line.receive(10)
    for n in range(20):
        line.send(encode(Ping(0, n + 1, n)))
    assert line.receive(20)

    line.reopen(30)
    heard = [line.receive(20) for _ in range(3)]

    assert line.now_ns() >= 30_000_000
    assert heard[:2] == ([b"\0", heard[1]] if resets else [b"", b""])
    assert not any(isinstance(m, Pong) for m in feed(b"", b"".join(heard))[1])


class Numbered:
    """A line on which frames with these numbers arrive."""

    def __init__(self, numbers: Sequence[int]) -> None:
        self._numbers, self._now_ns = iter(numbers), 0

    def receive(self, within_ms: float) -> bytes:
        """Return the next frame."""
        self._now_ns += round(within_ms * 1e6)
        return b"".join(encode(Ack(State.IDLE, n, 0, 0, 0)) for n in self._numbers)

    def now_ns(self) -> int:
        return self._now_ns


@pytest.mark.parametrize(
    ("numbers", "breaks"),
    [([7, 8, 9], 0), ([65_534, 65_535, 0, 1], 0), ([7, 9, 10], 1), ([5, 0, 0, 7, 6], 4)],
)
def test_each_frame_out_of_sequence_is_a_violation(numbers: list[int], breaks: int) -> None:
    conversation = LineHost(Numbered(numbers))

    conversation.listen(5)

    assert conversation.breaks == breaks


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({}, ""),
        ({"version": 99}, "version 99"),
        ({"schema": 5}, ", 5"),
        ({"full_scale_mv": 3300}, "full scale 3300 mV"),
        ({"boot_id": 0}, "boot_id 0"),
        ({"capabilities": Capability.SCHEDULED}, "capabilities 2"),
        ({"hold_us": 0}, "hold_us 0, skew_us 104"),
        ({"hold_us": 104}, "hold_us 104, skew_us 104"),
        ({"ts_min_us": 205}, "ts_min_us 205, skew_us 104"),
        ({"ts_min_us": 206}, ""),
        ({"adc_bits": 7}, "7, 10 bits"),
        ({"adc_bits": 17}, "17, 10 bits"),
        ({"pwm_bits": 0}, "10, 0 bits"),
        ({"pwm_bits": 17}, "10, 17 bits"),
        ({"queue": 47}, "a queue of 47"),
        ({"queue": 48}, ""),
        ({"queue": 513}, "a queue of 513"),
        ({"queue": 0, "capabilities": Capability.EXCHANGE}, ""),
    ],
    ids=str,
)
def test_an_implausible_device_is_recognised_by_its_hello(wrong: dict[str, int], says: str) -> None:
    host = LineHost(VirtualLine(Device(EmulatorSettings(boot_ms=5.0), 0)))
    host.facts = host.hello()._replace(**wrong)

    came = ""
    try:
        RULES[0].check(host)
    except Broken as err:
        came = str(err)

    assert says in came
    assert bool(says) == bool(came)


def test_the_rest_of_a_frame_at_the_opening_of_the_port_is_not_spoilt() -> None:
    rest, whole = b"\x05abc\0", encode(Ack(State.IDLE, 9, 0, 0, 0))
    pieces = [rest + whole, rest, b"\x07a", rest + whole, rest + rest]
    line = SimpleNamespace(now_ns=lambda: 0, receive=lambda ms: pieces.pop(0), reopen=id)
    conversation = LineHost(line)
    spoilt = []

    for opens in (False, False, False, True, False):
        if opens:
            conversation.reopen()
        conversation._read(1)
        spoilt.append(conversation.spoilt)

    assert spoilt == [0, 1, 1, 1, 3]
    assert conversation.breaks == 0


def test_a_limit_counts_from_the_time_at_which_it_was_set() -> None:
    line = Numbered(range(1))
    conversation = LineHost(line)
    conversation.listen(5)
    length = len(encode(Ack(State.IDLE, 0, 0, 0, 0)))
    conversation.limit(100, received=2 * length)

    for n, ends in ((2, False), (1, True)):
        conversation.line = Numbered(range(n))
        conversation.listen(5)
        if ends:
            with pytest.raises(EndlessError, match="sent more"):
                conversation.listen(5)
    conversation.limit()
    conversation.listen(5)


def test_every_rule_has_a_section_and_a_unique_sentence() -> None:
    assert {rule.section for rule in RULES} == {1, 2, 3, 4, 5, 6, 7}
    assert len({rule.sentence for rule in RULES}) == len(RULES)
