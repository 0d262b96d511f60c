"""Requests of the service to the core: each refusal, in its state."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from armrig_core.rig.calibration import Calibration, Driver, Potentiometer
from armrig_core.rig.volts import code_of
from armrig_daemon import pipe
from armrig_daemon.config import Config, Limits
from armrig_daemon.decisions.faults import Fault, Id
from armrig_daemon.decisions.outcomes import NO_DEVICE
from armrig_daemon.decisions.state import (
    ActiveRun,
    DecisionState,
    Event,
    Exit,
    Ordered,
    Phase,
    RequestKind,
    Tick,
)
from armrig_daemon.pipe import Alive, Answer, Calibrate, Order, Quit, Reset, RunEnded
from armrig_protocol.messages import ClearFault, Hello, Stop
from armrig_protocol.messages import State as DeviceState

from tests.daemon.decision_states import (
    ARM,
    LAW,
    RUN,
    SET,
    Decided,
    armed,
    awaiting,
    changed,
    control_run,
    driven,
    ordered,
    rested,
)
from tests.daemon.virtual_bench import LEASE, MS, Bench, codes

OTHER = Calibration(
    theta_1=Potentiometer(zero_counts=100.0, rad_per_count=-0.0625),
    alpha=Potentiometer(zero_counts=200.0, rad_per_count=0.03125, wraps=False),
    driver=Driver(gain=10.0, offset_v=5.0),
)
CALIBRATE = Calibrate(order=74, calibration=OTHER)


def _refusal(bench: Bench, order: Order, state: DecisionState | None = None) -> str:
    """Return the reason of a refused order, which has no other effect."""
    decided = ordered(bench, order, state)
    (answer,) = decided.told(Answer)
    assert answer.order == order.order
    assert len(decided.actions) == 1
    before = state or bench.loop.state
    assert decided.state == changed(before, service_ns=bench.ports.now)
    assert answer.code.passes == answer.error.endswith(": try again")
    return str(answer.error)


FAULT = {"phase": Phase.FAULT, "fault": Fault(Id.LEASE, "it ran out")}
IN_FAULT = "in fault (it ran out): correct the cause, then reset"
HELD = "a student has the rig: wait until it is free, or end it with `armrig stop`"
NOT_AT_REST = "the rig is not at rest yet: try again"
RUNNING, FILLING = (ActiveRun("r", codes(1.0), -1, scheduled=s) for s in (False, True))
SCHEDULED = changed(RUN, scheduled=True)
NO_LEASE = "not the lease in force"
CONTROL = control_run()
LIMITS = Config(limits=Limits(u_min_v=1.0, u_max_v=4.0)).rules()
WITHIN = {"lo_code": code_of(1.0), "hi_code": code_of(4.0)}
NARROW = {"rules": changed(LIMITS, rest_code=code_of(2.0))}
ALLOWED = "1 … 4 V, with rest"


def _law(**fields: int) -> Order:
    return control_run(changed(LAW, **fields))


REFUSALS: dict[str, tuple[Callable[[], Bench], dict[str, object], Order, str]] = {
    "an order of another release": (rested, {}, Order(order=5), "not an order"),
    "ARM of a rig that ends": (rested, {"quitting": True}, ARM, "ending"),
    "ARM before the device is met": (rested, {"device": None}, ARM, NO_DEVICE),
    "ARM before it is configured": (rested, {"phase": Phase.INIT}, ARM, NO_DEVICE),
    "ARM of a held rig": (armed, {}, ARM, HELD),
    "ARM in a fault": (armed, FAULT, ARM, IN_FAULT),
    "reset without a device": (rested, FAULT | {"device": None}, Reset(order=8), NO_DEVICE),
    "calibration of an armed rig": (armed, {}, CALIBRATE, HELD),
    "calibration of a driven rig": (driven, {}, CALIBRATE, HELD),
    "calibration in a fault": (rested, FAULT, CALIBRATE, IN_FAULT),
    "calibration without a device": (rested, {"phase": Phase.INIT}, CALIBRATE, NO_DEVICE),
    "calibration in a run": (rested, {"phase": Phase.ACTIVE}, CALIBRATE, NOT_AT_REST),
    "S5: a lease in INIT": (armed, {"phase": Phase.INIT}, SET, NO_LEASE),
    "S5: a lease in SAFE": (armed, {"phase": Phase.SAFE}, SET, NO_LEASE),
    "S5: a lease in FAULT": (armed, {"phase": Phase.FAULT}, SET, NO_LEASE),
    "S5: another lease": (armed, {}, changed(SET, lease="b" * 32), NO_LEASE),
    "SET in a run": (driven, {"run": RUNNING}, SET, "experiment r is running"),
    "RUN while driven by hand": (driven, {}, RUN, "driven by hand"),
    "RUN while a queue fills": (armed, {"run": FILLING}, RUN, "r is about to start"),
    "RUN of no sample": (armed, {}, changed(RUN, codes=b""), "empty"),
    "law in scheduled mode": (armed, {}, changed(CONTROL, scheduled=True), "request exchange mode"),
    "law of another Ts": (armed, {}, _law(Ts_us=5000), "Ts=0.005 s, and the rig 0.01 s"),
    "law below the limits": (armed, NARROW, _law(**WITHIN | {"lo_code": 13_106}), ALLOWED),
    "law above the limits": (armed, NARROW, _law(**WITHIN | {"hi_code": 52_429}), ALLOWED),
    "law above rest": (armed, NARROW, _law(**WITHIN | {"lo_code": 26_215}), ALLOWED),
    "law below rest": (armed, NARROW, _law(**WITHIN | {"hi_code": 26_213}), ALLOWED),
    "law without a reference": (armed, {}, control_run(r=()), "the reference has 0 bytes"),
    "law with half a sample": (armed, {}, changed(CONTROL, reference=b"1234"), "has 4 bytes"),
    "scheduled RUN without a device": (armed, {"device": None}, SCHEDULED, "no scheduled mode"),
}


@pytest.mark.parametrize("rule", REFUSALS)
def test_an_order_is_refused_and_changes_nothing(rule: str) -> None:
    make, change, order, text = REFUSALS[rule]
    bench = make()

    assert text in _refusal(bench, order, changed(bench.loop.state, **change))


def test_a_law_with_the_limits_of_the_rig_is_accepted() -> None:
    bench = armed()
    decided = ordered(bench, _law(**WITHIN), changed(bench.loop.state, **NARROW))

    assert not decided.told(Answer)
    assert decided.state.asked.want is RequestKind.START


@pytest.mark.parametrize(
    ("order", "text"),
    [(CALIBRATE, NOT_AT_REST), (Reset(order=8), "busy with STOP: try again")],
    ids=["calibration", "S6: reset"],
)
def test_an_order_waits_for_the_stop(order: Order, text: str) -> None:
    bench = rested()
    phase = Phase.FAULT if isinstance(order, Reset) else Phase.SAFE
    state = awaiting(changed(bench.loop.state, phase=phase), RequestKind.STOP)

    assert _refusal(bench, order, state) == text


def test_a_scheduled_run_needs_a_device_with_scheduled_mode() -> None:
    bench = armed()
    device = bench.loop.state.device
    exchanging = changed(bench.loop.state, device=device._replace(capabilities=1))

    assert "no scheduled mode" in _refusal(bench, SCHEDULED, exchanging)


def test_a_sign_of_life_of_the_service_only_updates_its_time() -> None:
    bench = driven()
    decided = ordered(bench, Alive())

    assert decided.actions == []
    assert decided.state == changed(bench.loop.state, service_ns=bench.ports.now)


def test_a_sign_of_life_for_a_lease_renews_only_a_rig_that_is_armed_at_0_v() -> None:
    """S2: a held voltage needs a command of its holder."""
    alive = Alive(lease=LEASE)
    bench = armed()
    decided = ordered(bench, alive)
    assert decided.state.lease.renewed_ns == bench.ports.now
    assert decided.state.lease.n == bench.loop.state.lease.n

    other = ordered(bench, Alive(lease="f" * 32))
    turning, rest = driven(), rested()
    assert other.state.lease == bench.loop.state.lease
    assert ordered(turning, alive).state.lease == turning.loop.state.lease
    assert ordered(rest, alive).state.lease is None


def test_a_repeated_quit_order_sends_no_second_stop() -> None:
    bench = driven()
    once = ordered(bench, Quit(reason="SIGTERM"))
    again = ordered(bench, Quit(reason="SIGTERM"), once.state)

    assert [type(m) for m in once.sent] == [Stop]
    assert again.actions == []
    assert again.state == once.state


@pytest.mark.parametrize("gone", [{"link": None}, {"device": None}])
def test_quit_without_a_device_exits_at_once(gone: dict[str, object]) -> None:
    bench = driven()
    state = changed(
        bench.loop.state, run=ActiveRun("r", codes(1.0), -1), outcome="unplugged", **gone
    )

    decided = ordered(bench, Quit(reason="SIGTERM"), state)

    assert [r.outcome for r in decided.told(RunEnded)] == ["unplugged"]
    assert isinstance(decided.actions[-1], Exit)
    assert decided.sent == []


@pytest.mark.parametrize("want", list(RequestKind))
@pytest.mark.parametrize("order", [ARM, SET, RUN])
def test_an_order_during_a_device_request_is_refused_as_busy(
    want: RequestKind, order: Order
) -> None:
    bench = rested() if isinstance(order, pipe.Arm) else armed()
    state = awaiting(bench.loop.state, want)

    assert _refusal(bench, order, state) == f"busy with {want}: try again"


def test_arming_needs_a_fresh_round_trip() -> None:
    """S4: 50 ms at Ts 10 ms, and not a nanosecond more."""
    bench = rested()
    old = changed(bench.loop.state, last_round_trip_ns=bench.ports.now - 50 * MS)

    assert ordered(bench, ARM, old).told(Answer) == []
    assert "no answer" in _refusal(
        bench, ARM, changed(old, last_round_trip_ns=old.link.last_round_trip_ns - 1)
    )


def test_arming_needs_a_fresh_sample() -> None:
    bench = rested()
    none = changed(bench.loop.state, sampled_ns=0)
    oldest = changed(none, sampled_ns=bench.ports.now - 50 * MS)
    older = changed(none, sampled_ns=oldest.sampled_ns - 1)

    text = "no sample of the device in the last 50 ms: try again"
    assert _refusal(bench, ARM, none) == text
    (answer,) = ordered(bench, ARM, none).told(Answer)
    assert answer.parameters == {"limit_ms": 50.0}
    assert _refusal(bench, ARM, older) == text
    assert ordered(bench, ARM, oldest).told(Answer) == []


@pytest.mark.parametrize("state", [s for s in DeviceState if s not in (2, 3)])
def test_a_device_that_is_not_at_rest_gets_a_hello(state: DeviceState) -> None:
    bench = rested()

    decided = ordered(bench, ARM, changed(bench.loop.state, device_state=int(state)))

    (answer,) = decided.told(Answer)
    assert answer.error == f"the device is in {state.name}, not at rest: try again"
    assert [type(m) for m in decided.sent] == [Hello]


# -- the reset -----------------------------------------------------------------------------------


def _in_fault(bench: Bench, device_state: DeviceState = DeviceState.IDLE) -> DecisionState:
    return changed(bench.loop.state, phase=Phase.FAULT, device_state=int(device_state))


def test_a_reset_without_a_latched_fault_is_answered_at_once() -> None:
    bench = armed()
    decided = ordered(bench, Reset(order=8))

    assert [a.body for a in decided.told(Answer)] == [{"done": False}]
    assert decided.state.phase is Phase.ARMED
    assert decided.sent == []


@pytest.mark.parametrize(
    ("state", "asks"),
    [
        (DeviceState.FAULT, ClearFault),
        (DeviceState.ESTOP, ClearFault),
        (DeviceState.IDLE, Hello),
        (DeviceState.READY, Hello),
    ],
)
def test_a_reset_clears_the_latched_fault_of_the_device(state: DeviceState, asks: type) -> None:
    bench = rested()
    latched = changed(_in_fault(bench, state), token=12345)

    (sent,) = ordered(bench, Reset(order=8), latched).sent

    assert type(sent) is asks
    assert not isinstance(sent, ClearFault) or sent.token == 12345


# -- the calibration -----------------------------------------------------------------------------


def test_a_calibration_is_accepted_at_rest_and_changes_only_the_angles() -> None:
    """S1 to S6: no frame is sent; codes, limits and phase stay."""
    bench = rested()
    before = bench.loop.state

    decided = ordered(bench, CALIBRATE)

    assert [a.body for a in decided.told(Answer)] == [{"done": True}]
    assert len(decided.actions) == 1
    rules = changed(before.rules, calibration=OTHER)
    assert decided.state == changed(before, rules=rules, service_ns=bench.ports.now)


def test_the_next_sample_is_converted_by_the_new_calibration() -> None:
    bench = rested()
    assert not bench.ask(Calibrate, calibration=OTHER).error
    k = bench.loop.state.k
    bench.run_for(50)

    later = [s for s in bench.samples if s.k > k]
    assert later
    assert all(s.value_0 == (100 - s.counts_0) / 16 for s in later)
    assert all(s.value_1 == (s.counts_1 - 200) / 32 for s in later)
    assert {s.u_applied_v for s in later} == {0.0}


# -- the stop ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "change",
    [{"phase": Phase.SAFE}, {"phase": Phase.FAULT}, {"device": None}],
)
def test_stop_of_a_motor_at_rest_is_answered_at_once(change: dict[str, object]) -> None:
    bench = driven()
    decided = ordered(bench, pipe.Stop(order=6), changed(bench.loop.state, **change))

    assert [a.body for a in decided.told(Answer)] == [{"done": True}]
    assert decided.sent == []


def test_a_stop_overtakes_a_pending_request_at_rest() -> None:
    bench = rested()
    decided = ordered(
        bench, pipe.Stop(order=6), awaiting(bench.loop.state, RequestKind.CONFIGURE, ARM)
    )

    assert [type(m) for m in decided.sent] == [Stop]
    assert [(a.order, a.error) for a in decided.told(Answer)] == [(71, "not begun: stopped")]


@pytest.mark.parametrize(
    "order", [pipe.Stop(order=8), pipe.Disarm(order=8, lease=LEASE, n=51)], ids=["stop", "release"]
)
@pytest.mark.parametrize("by", ["a trip", "another stop"])
def test_a_stop_overtaken_by_another_stop_is_answered(
    order: pipe.Stop | pipe.Disarm, by: str
) -> None:
    bench = driven()
    told = ordered(bench, order)
    event: Event = Ordered(pipe.Stop(order=9))
    at_ns = bench.ports.now
    if by == "a trip":
        event, at_ns = Tick(told.state.k + 1, at_ns), at_ns + 1_000 * MS

    decided = Decided(told.state, at_ns, event)

    assert told.told(Answer) == []
    assert [(a.order, a.error) for a in decided.told(Answer)] == [(8, "")]
    assert [type(m) for m in decided.sent] == [Stop]


# -- the lease's holder --------------------------------------------------------------------------


def test_number_of_a_command_must_grow() -> None:
    """S5: the same number again is an old command."""
    bench = armed()
    state = bench.loop.state
    assert state.lease is not None
    at_7 = changed(state, lease=changed(state.lease, n=7))

    assert "n=7 must be greater than the last, 7" in _refusal(bench, changed(SET, n=7), at_7)
    assert ordered(bench, changed(SET, n=8), at_7).told(Answer) == []


def test_a_command_renews_the_lease_from_its_arrival() -> None:
    """S2: and its number is the one to exceed."""
    bench = driven()

    lease = ordered(bench, SET).state.lease

    assert (lease.n, lease.renewed_ns) == (50, bench.ports.now)


def test_set_of_a_driven_rig_changes_the_code() -> None:
    bench = driven()
    decided = ordered(bench, SET)

    assert decided.state.code == SET.code
    assert [a.body for a in decided.told(Answer)] == [{"done": True}]
    assert decided.sent == []


@pytest.mark.parametrize("order", [SET, RUN])
def test_a_sampling_time_too_short_for_exchange_mode_is_refused_in_it(order: Order) -> None:
    """Armed for 0.9 ms, at 500 kBd only scheduled: the host ticks slower than that."""
    bench = rested()
    assert not bench.arm(900).error
    assert bench.loop.state.ts_us != 900

    assert "Ts=0.0009 s cannot be carried in exchange mode" in _refusal(bench, order)


@pytest.mark.parametrize(
    ("volts", "error"),
    [
        (2.4, ""),
        (2.5, ""),
        (2.6, "u steps by 1.1 V: at most 1 V in a sample"),
        (0.5, ""),
        (0.3, "u steps by 1.2 V: at most 1 V in a sample"),
        (0.15, "u=0.15 V is outside 0.2 … 4.4 V"),
        (4.5, "u=4.5 V is outside 0.2 … 4.4 V"),
    ],
)
def test_a_voltage_by_hand_beyond_the_limits_or_the_slew_is_refused(
    volts: float, error: str
) -> None:
    """S1: 1 V per sample, from 1.5 V."""
    bench = Bench(Config(limits=Limits(u_min_v=0.2, u_max_v=4.4, slew_v=1.0)))
    bench.arm()
    for n, u in enumerate((0.8, 1.5)):
        bench.order(pipe.Set(order=98 + n, lease=LEASE, n=n, code=code_of(u)))
        bench.run_for(20)

    (answer,) = ordered(bench, changed(SET, code=code_of(volts))).told(Answer)

    assert answer.error == error


def test_run_begins_by_start_or_by_stop_for_a_configuration() -> None:
    bench = armed()
    for scheduled, want in ((False, RequestKind.START), (True, RequestKind.STOP)):
        order: pipe.Run = changed(RUN, scheduled=scheduled)
        asked = ordered(bench, order).state.asked
        assert (asked.want, asked.order) == (want, order)
