"""The monitor of a law: its two gates, and the prelude before the loop closes."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, nan, tau
from typing import Any

import pytest
from armrig_core.control.evaluation import Latch, Program, begin, decide, observe
from armrig_core.control.monitor import (
    Alarm,
    Gate,
    MonitorProgram,
    MonitorState,
    advance,
    alarm,
    find_lost_output,
    predict_outputs,
)
from armrig_core.control.monitor import begin as begin_monitor
from armrig_core.rig.description import builtin
from armrig_core.rig.volts import volts_of
from msgspec.structs import replace

from tests.core.control.laws import arm_law, arm_monitor

INNOVATION, SIMULATION = Alarm(Gate.INNOVATION, 0, "y"), Alarm(Gate.SIMULATION, 0, "y")
RIG = Latch(rest_code=0)


def _monitor(a: float = 0.0, b: float = 0.0, gain: float = 0.0, **changes: Any) -> MonitorProgram:
    """Return x[k+1] = a x[k] + b u[k] + gain e[k] with y = x, whose deviation is 1."""
    fields = {
        "outputs": ("y",),
        "rows": ((a, b, gain),),
        "predictions": ((1.0,),),
        "x0": (0.0,),
        "u0": 0.0,
        "deviations": (1.0,),
        "settling": (False,),
        "input_delay": 0,
        "prelude": 0,
        "forward": (0.0, 0.0),
        "most_blind": 100,
        "most_turned": (None,) * len(changes.get("outputs", "y")),
    }
    return MonitorProgram(**{**fields, **changes})


def _two(**changes: Any) -> MonitorProgram:
    """Return the monitor of two outputs that the model expects at 0."""
    fields = {
        "outputs": ("y", "z"),
        "rows": ((0.0,) * 4,),
        "predictions": ((1.0,), (1.0,)),
        "deviations": (1.0, 1.0),
        "settling": (False, False),
    }
    return _monitor(**{**fields, **changes})


def _watched(
    monitor: MonitorProgram, y: Sequence[float | None], u_v: float = 0.0
) -> tuple[MonitorState, list[Alarm | None]]:
    """Return the state after the samples of one output, None being missing, and all alarms."""
    state, alarms = begin_monitor(monitor), []
    for value in y:
        state = advance(monitor, state, (value or 0.0,), (value is not None,), u_v)
        alarms.append(alarm(monitor, state))
    return state, alarms


# -- the gates -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("monitor", "tripped"),
    [
        (_monitor(), INNOVATION),
        (_monitor(a=1.0, gain=1.0, settling=(True,), deviations=(0.2,)), SIMULATION),
    ],
    ids=["innovation", "simulation"],
)
def test_a_gate_trips_at_the_fifth_sample_in_a_row(monitor: MonitorProgram, tripped: Alarm) -> None:
    """For the simulation gate, y rises by 1: the observer follows, the simulation stays at 0."""
    steps = [0.0, 7.0, 8.0, 9.0, 10.0, 11.0]
    if tripped is SIMULATION:
        steps = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]

    _, alarms = _watched(monitor, steps)

    assert alarms == [*[None] * (len(steps) - 1), tripped]


@pytest.mark.parametrize("settles", [False, True])
def test_four_samples_beyond_a_gate_are_forgotten_after_one_within(settles: bool) -> None:
    monitor = _monitor(settling=(settles,))

    state, alarms = _watched(monitor, [0.0, *[7.0] * 4, 6.0, *[-7.0] * 4, -6.0])

    assert alarms == [None] * 11
    assert (state.unlike, state.astray) == ((0,), (0,))


@pytest.mark.parametrize("settles", [False, True])
def test_a_missing_output_neither_counts_nor_clears(settles: bool) -> None:
    gap = [None] * 9

    state, alarms = _watched(_monitor(settling=(settles,)), [0.0, *[7.0] * 4, *gap])
    _, tripped = _watched(_monitor(settling=(settles,)), [0.0, *[7.0] * 4, *gap, 7.0])

    assert (state.unlike, state.astray) == ((4,), (4 * settles,))
    assert alarms == [None] * 14
    assert tripped[-1] == INNOVATION


def test_each_output_has_its_own_counts_and_its_own_name() -> None:
    """The outputs y and z alternate beyond their gates; then only z is beyond its gate."""
    monitor = _two()
    state = begin_monitor(monitor)
    for y in [(0.0, 0.0), *[(9.0, 0.0), (0.0, 9.0)] * 5]:
        state = advance(monitor, state, y, (True, True), 0.0)
        assert alarm(monitor, state) is None
    for _ in range(4):
        assert alarm(monitor, state) is None
        state = advance(monitor, state, (0.0, 9.0), (True, True), 0.0)

    assert alarm(monitor, state) == Alarm(Gate.INNOVATION, 1, "z")


def test_one_output_may_be_missing_while_the_other_is_watched() -> None:
    monitor = _two(settling=(True, True))
    state = begin_monitor(monitor)
    for y in [(0.0, 0.0), *[(9.0, 9.0)] * 5]:
        state = advance(monitor, state, y, (False, True), 0.0)

    assert (state.unlike, state.astray) == ((0, 5), (0, 5))
    assert state.zeros == (None, 0.0)
    assert alarm(monitor, state) == Alarm(Gate.INNOVATION, 1, "z")


@pytest.mark.parametrize("settles", [False, True])
@pytest.mark.parametrize("first", [0, 1, 3])
def test_the_zero_of_an_output_is_at_its_first_valid_sample(first: int, settles: bool) -> None:
    """The output is 1000 from the model: its changes are compared, not its level."""
    y = [*[None] * first, *[1000.0, 1001.0, 999.0] * 3]

    state, alarms = _watched(_monitor(settling=(settles,)), y)

    assert state.zeros == (1000.0,)
    assert alarms == [None] * len(y)


@pytest.mark.parametrize(("x0", "late"), [(nan, 0), (inf, 0), (-inf, 0), (1e308, 1)])
def test_a_difference_that_is_not_finite_is_beyond_each_gate(x0: float, late: int) -> None:
    """The model is not finite from its beginning, or overflows at its first step."""
    monitor = _monitor(a=10.0, settling=(True,), x0=(x0,))

    state, alarms = _watched(monitor, [0.0] * (5 + late))

    assert alarms == [*[None] * (4 + late), INNOVATION]
    assert (state.unlike, state.astray) == ((5,), (5,))


def test_a_simulation_of_infinite_range_does_not_open_its_gate() -> None:
    """A quarter of the range would allow any difference; the observer's state stays finite."""
    monitor = _monitor(a=1e200, gain=0.0, settling=(True,), deviations=(1e300,), x0=(1e-100,))
    state = begin_monitor(monitor)
    counts = []
    for _ in range(6):
        state = advance(monitor, replace(state, x=(0.0,)), (0.0,), (True,), 0.0)
        counts.append(state.astray[0])

    assert state.high == (inf,)
    assert counts == [0, 0, 0, 1, 2, 3]


@pytest.mark.parametrize(("difference", "count"), [(20.0, 0), (26.0, 9)])
def test_the_simulation_may_differ_by_a_quarter_of_its_range(difference: float, count: int) -> None:
    """The model settles at 100 at once, so its range is 0 to 100."""
    monitor = _monitor(b=100.0, settling=(True,), deviations=(1e-3,))

    state, _ = _watched(monitor, [0.0, *[100.0 - difference] * 9], u_v=1.0)

    assert (state.low, state.high) == ((0.0,), (100.0,))
    assert state.astray == (count,)
    assert state.unlike == (9,)


def test_an_output_that_does_not_settle_has_no_simulation_gate() -> None:
    drifting = [float(k) for k in range(100)]

    state, alarms = _watched(_monitor(a=1.0, gain=1.0), drifting)

    assert not any(alarms)
    assert (state.simulated, state.astray) == ((0.0,), (0,))


def test_an_output_that_begins_away_from_rest_may_return_to_rest() -> None:
    """The zero is 4, and y falls back to 0, while the simulation stays at 0."""
    monitor = _monitor(a=1.0, gain=1.0, settling=(True,), deviations=(0.2,))

    _, warm = _watched(monitor, [4.0, *[3.0, 2.0, 1.0, 0.0], *[0.0] * 20])
    _, stuck = _watched(monitor, [4.0, *[3.0, 2.0, 1.0, 0.0, -1.0, -2.0, -3.0], *[-3.0] * 5])

    assert set(warm) == {None}
    assert stuck[-1] == SIMULATION


def test_an_output_is_lost_although_the_other_is_valid() -> None:
    monitor = _two(most_blind=3, most_turned=(None, None))
    state = begin_monitor(monitor)

    names = []
    for valid in [(True, True), *[(True, False)] * 3, (True, True), (False, True)]:
        state = advance(monitor, state, (0.0, 0.0), valid, 0.0)
        names.append(find_lost_output(monitor, state))

    assert names == ["", "", "", "z", "", ""]


def test_a_turning_output_is_lost_by_its_predicted_turn_and_not_by_time() -> None:
    """The prediction rises by 0.1 rad for each volt and sample."""
    monitor = _monitor(a=1.0, b=0.1, gain=1.0, most_blind=3, most_turned=(0.35,))

    def names(volts: float, count: int) -> list[str]:
        state, _ = _watched(monitor, [0.0])
        found = []
        for _ in range(count):
            state = advance(monitor, state, (0.0,), (False,), volts)
            found.append(find_lost_output(monitor, state))
        return found

    assert names(0.0, 50) == [""] * 50
    assert names(1.0, 6) == ["", "", "", "", "", "y"]


def test_the_bound_of_a_turn_is_the_dead_band_and_a_margin() -> None:
    """The arm's potentiometer has 352 degrees."""
    program = arm_law(monitor=arm_monitor()).program(builtin("arm"))

    assert program.monitor is not None
    turn, none = program.monitor.most_turned
    assert turn == pytest.approx(tau * 8 / 360 + 0.1, abs=0.01)
    assert (none, program.monitor.most_blind) == (None, program.most_blind)


def test_the_monitor_predicts_the_outputs_from_their_zeros() -> None:
    state, _ = _watched(_monitor(a=1.0, b=0.5, gain=1.0), [40.0, 41.0], u_v=2.0)

    assert state.zeros == (40.0,)
    assert predict_outputs(_monitor(), state) == (42.0,)
    assert predict_outputs(_monitor(), begin_monitor(_monitor())) == (0.0,)


# -- the law and its monitor ---------------------------------------------------------------------


def _law(monitor: MonitorProgram, **changes: Any) -> Program:
    """Return the law x[k+1] = y1[k], v = x."""
    fields = {
        "law_sha256": "",
        "Ts_us": 10_000,
        "rows": ((0.0, 0.0, 0.0, 1.0),),
        "v_row": (1.0, 0.0),
        "u0": 0.0,
        "x0": (0.0,),
        "predictions": None,
        "channels": (0,),
        "y0": (0.0,),
        "turning": (False,),
        "lo_code": 0,
        "hi_code": 65535,
        "slew": 0,
        "input_delay": 0,
        "most_blind": 20,
        "most_limited": 0,
        "tracked": None,
        "most_error": 0.0,
        "most_astray": 0,
        "monitor": monitor,
    }
    return Program(**{**fields, **changes})


@pytest.mark.parametrize(("delay", "of_law"), [(0, 2), (2, 0), (3, 1), (1, 3)])
def test_the_monitor_has_a_dead_time_of_its_own(delay: int, of_law: int) -> None:
    """The state of the law, and that of the monitor, is the voltage of the sample before."""
    monitor = _monitor(b=1.0, input_delay=delay)
    rows, v_row = ((0.0, 0.0, 1.0, 0.0),), (0.0, 1.0)
    law = _law(monitor, rows=rows, v_row=v_row, input_delay=of_law)
    state, reference = begin(law), [0.5 * k for k in range(9)]
    codes = []
    for k in range(9):
        state, command = decide(law, state, k, reference, RIG)
        codes.append(command.code)
        state = observe(law, state, k, (0.0,), reference, RIG)

        assert state.x == (volts_of(codes[k - of_law]) if k >= of_law else 0.0,)
        assert state.monitor.x == (volts_of(codes[k - delay]) if k >= delay else 0.0,)


def test_the_prelude_is_feed_forward_while_the_law_runs_along() -> None:
    """The loop closes at sample 3 with the law's state of the samples before."""
    monitor = _monitor(prelude=3, forward=(2.0, 0.25))
    law, reference = _law(monitor), [1.0, 0.5, 0.25, 1.0, 1.0]
    state, v = begin(law), []
    for k, y in enumerate([3.0, 1.5, 4.5, 2.0, 0.0]):
        state, command = decide(law, state, k, reference, RIG)
        v.append(command.v)
        state = observe(law, state, k, (y,), reference, RIG)
        assert state.x == (y,)

    assert v == [2.25, 1.25, 0.75, 4.5, 2.0]


def test_the_prelude_has_the_limits_and_the_slew_of_the_law() -> None:
    monitor = _monitor(prelude=6, forward=(1.0, 0.0))
    law = _law(monitor, lo_code=13107, hi_code=39321, slew=10_000)
    state, commands, reference = begin(law), [], [5.0] * 4 + [0.0] * 4
    for k in range(6):
        state, command = decide(law, state, k, reference, Latch(rest_code=13107))
        commands.append(command)
        state = observe(law, state, k, (0.0,), reference, Latch(rest_code=13107))

    assert [c.code for c in commands] == [23107, 33107, 39321, 39321, 29321, 19321]
    assert [c.is_high for c in commands] == [True] * 4 + [False] * 2
    assert [c.is_low for c in commands] == [False] * 4 + [True] * 2
    assert [c.is_slewed for c in commands] == [True, True, False, False, True, True]


def test_a_prelude_without_a_finite_voltage_is_at_rest() -> None:
    monitor = _monitor(prelude=6, forward=(1e308, 1e308))

    _, command = decide(_law(monitor), begin(_law(monitor)), 0, [5.0], Latch(rest_code=700))

    assert (command.code, command.v) == (700, inf)


def test_the_control_error_counts_from_the_end_of_the_prelude() -> None:
    monitor = _monitor(prelude=4)
    law = _law(monitor, tracked=(0.0, 0.0, 0.0), most_error=0.5, most_astray=99)
    state, counts = begin(law), []
    for k in range(7):
        state = observe(law, state, k, (0.0,), [1.0] * 7, RIG)
        counts.append(state.astray)

    assert counts == [0, 0, 0, 0, 1, 2, 3]


def test_a_turning_output_without_F_is_counted_by_the_monitor_in_a_dead_band() -> None:
    """The shaft turns by 1 rad a sample, and is unseen for 10 samples: more than one turn."""
    monitor = _monitor(a=1.0, b=1.0, gain=1.0)
    law, reference = _law(monitor, turning=(True,), most_blind=50), [1.0] * 40
    rows, v_row = ((0.0, 0.0, 0.0, 1.0),), (0.0, 1.0)
    law = replace(law, rows=rows, v_row=v_row)
    state = begin(law)
    for k in range(40):
        state, _ = decide(law, state, k, reference, RIG)
        seen = (6.0 + k) % tau if not 12 <= k < 22 else nan
        state = observe(law, state, k, (seen,), reference, RIG)
        assert state.y == pytest.approx((float(k),), abs=1e-9)
        assert state.blind == (k - 11 if 12 <= k < 22 else 0)

    assert state.zeros == (6.0,)
    assert alarm(monitor, state.monitor) is None


def test_F_of_the_law_comes_before_the_monitor() -> None:
    law = _law(_monitor(a=1.0, b=1.0), predictions=((0.5,),))
    state = observe(law, begin(law), 0, (4.0,), [0.0] * 2, RIG)
    state = observe(law, state, 1, (nan,), [0.0] * 2, RIG)

    assert state.y == (2.0,)


def test_samples_that_have_not_arrived_count_by_no_gate() -> None:
    """Tick 6 is decided without samples 2 to 5, which are then lost."""
    law = _law(_monitor())
    state, reference = begin(law), [0.0] * 9
    for k, y in enumerate([0.0, 9.0]):
        state, _ = decide(law, state, k, reference, RIG)
        state = observe(law, state, k, (y,), reference, RIG)
    state, command = decide(law, state, 6, reference, RIG)
    state = observe(law, state, 6, (9.0,), reference, RIG)

    assert command.predicted == 4
    assert state.monitor.unlike == (2,)


def test_a_program_has_the_monitor_of_its_file() -> None:
    law = arm_law(monitor=arm_monitor(prelude=50, input_delay=3, forward=(0.5, 0.1)))

    monitor = law.program(builtin("arm")).monitor

    assert monitor is not None
    assert monitor.outputs == ("theta_1", "alpha")
    assert (monitor.prelude, monitor.input_delay, monitor.forward) == (50, 3, (0.5, 0.1))
    assert monitor.rows[0] == (*law.monitor.A[0], law.monitor.B[0], *law.monitor.L[0])
    assert arm_law().program(builtin("arm")).monitor is None
    assert begin(arm_law().program(builtin("arm"))).monitor is None
