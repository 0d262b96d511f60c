"""The pins of a simulated board against the frames of its firmware, without a board."""

from __future__ import annotations

import pytest
from armrig_daemon.emulator.harness import Duty, Violated, Violation
from armrig_daemon.emulator.pin import Pins
from armrig_protocol.frame import Spoilt, encode
from armrig_protocol.messages import TYPES, Ack, Code, Event, Keepalive, Sample, Start, State

PERIOD = 1024
OUTSIDE, OTHER_CODE = Violation.DRIVEN_OUTSIDE_RUN, Violation.CODE_NOT_AT_PIN


def of(kind: type, state: State, **fields: int) -> object:
    """Return a frame of the device in a state, all else 0."""
    return kind._make([0] * len(kind._fields))._replace(state=state, **fields)


def started(noted: list[Violated]) -> Pins:
    """Return the pins of a board that has answered START at cycle 3000, and drives since 4000."""
    pins = Pins(noted.append, PERIOD)
    pins.send(1000, b"\0" + encode(Start(0, 7, 0, 0)))
    pins.tell(3000, of(Ack, State.RUN, of_type=TYPES[Start], of_seq=7))
    pins.measure(Duty(4000, 512, True))
    return pins


@pytest.mark.parametrize("duty", [(512, True), (1, False), (0, True)])
def test_a_motor_that_is_driven_before_any_start_is_noted_at_once(duty: tuple[int, bool]) -> None:
    noted: list[Violated] = []
    pins = Pins(noted.append, PERIOD)

    pins.measure(Duty(500, 0, False))
    pins.measure(Duty(700, *duty))
    pins.measure(Duty(900, 3, True))

    assert noted == [Violated(700, OUTSIDE)]
    pins.measure(Duty(1000, 0, False))
    pins.measure(Duty(1200, *duty))
    assert noted[1:] == [Violated(1200, OUTSIDE)]


@pytest.mark.parametrize("state", [State.IDLE, State.FAULT, State.ESTOP, State.READY])
def test_a_motor_that_is_driven_on_is_noted_two_periods_after_the_end_of_run(state: State) -> None:
    noted: list[Violated] = []
    pins = started(noted)

    pins.look(49_000)
    pins.tell(50_000, of(Event, state))
    pins.look(50_000 + 2 * PERIOD)
    assert noted == []
    pins.look(50_001 + 2 * PERIOD)
    pins.look(90_000)

    assert noted == [Violated(50_001 + 2 * PERIOD, OUTSIDE)]


def test_a_motor_switched_off_in_time_or_driven_in_a_run_is_not_noted() -> None:
    noted: list[Violated] = []
    pins = started(noted)

    pins.tell(40_000, of(Event, State.RUN))
    pins.look(49_000)
    pins.tell(50_000, of(Event, State.IDLE))
    pins.measure(Duty(50_900, 0, False))
    pins.look(90_000)

    assert noted == []


def test_a_start_allows_the_motor_until_it_is_answered() -> None:
    """The answer to an older START, another frame and noise do not end the wait."""
    noted: list[Violated] = []
    pins = Pins(noted.append, PERIOD)
    pins.send(1000, b"\0" + encode(Keepalive(0, 6)) + encode(Start(0, 7, 0, 0)))
    pins.measure(Duty(2000, 512, True))

    pins.tell(3000, of(Ack, State.ARMED, of_type=TYPES[Start], of_seq=6))
    pins.tell(3500, Spoilt("crc"))
    pins.look(30_000)
    assert noted == []
    answer = of(Ack, State.ARMED, of_type=TYPES[Start], of_seq=7, code=Code.WRONG_NONCE)
    pins.tell(40_000, answer)
    pins.look(60_000)

    assert noted == [Violated(60_000, OUTSIDE)]


def test_a_reset_ends_the_run() -> None:
    noted: list[Violated] = []
    pins = started(noted)

    pins.reset(20_000)
    pins.look(20_000 + 2 * PERIOD)
    pins.look(30_000)

    assert noted == [Violated(30_000, OUTSIDE)]


@pytest.mark.parametrize(
    ("high", "code", "differs"),
    [
        (0, 0, False),
        (0, 64, True),
        (1, 64, False),
        (1, 0, True),
        (512, 32_768, False),
        (512, 32_704, True),
        (512, 32_832, True),
        (1024, 65_535, False),
        (1024, 65_471, True),
    ],
)
def test_the_duty_before_the_latch_is_compared_with_the_code_before(
    high: int, code: int, differs: bool
) -> None:
    """Not with the duty of the sample itself, which the pin has from the next period on."""
    noted: list[Violated] = []
    pins = started(noted)
    pins.measure(Duty(100_000, high, True))
    pins.hold(100_000 + PERIOD)
    pins.measure(Duty(100_001 + PERIOD, 300, True))

    sample = of(Sample, State.RUN, u_k=19_200, u_km1=code, t_us=99)
    pins.tell(110_000, sample)

    assert noted == ([Violated(100_000 + PERIOD, OTHER_CODE)] if differs else [])


def test_each_violation_has_a_different_sentence() -> None:
    assert len({what.sentence for what in Violation}) == len(Violation)
