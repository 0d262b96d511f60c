"""Conditions of the device before the motor is armed."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from armrig_daemon.config import Config
from armrig_daemon.decisions.budget import min_exchange_us
from armrig_daemon.decisions.outcomes import NO_DEVICE
from armrig_daemon.decisions.state import LinkDown, LinkUp, Phase
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.pipe import Answer, Arm, Log
from armrig_daemon.virtual import VirtualRig
from armrig_protocol.decoder import feed
from armrig_protocol.frame import encode
from armrig_protocol.messages import ConfigReply, HelloReply
from armrig_protocol.messages import State as DeviceState

from tests.daemon.decision_states import changed
from tests.daemon.virtual_bench import LEASE, Bench


def _altered(of: type, alter: Callable[[], dict[str, int]]) -> Callable[[bytes], bytes]:
    """Return a line on which messages of one kind are others."""

    def other(data: bytes) -> bytes:
        _, messages = feed(b"", data)
        return b"".join(encode(m._replace(**alter()) if isinstance(m, of) else m) for m in messages)

    return other


def _unmet(alter: Callable[[], dict[str, int]], of: type = HelloReply) -> Bench:
    """Return a bench on which each message of a kind is altered, from the first on."""
    rig = Bench.__new__(Bench)
    VirtualRig.__init__(rig, Config().rules(), EmulatorSettings(boot_ms=0.0))
    rig._number, rig.lateness_ns = 0, 0
    rig.ports.from_device = _altered(of, alter)
    return rig


@pytest.mark.parametrize("state", [DeviceState.HOST, 8, 99, 255])
def test_device_in_an_undefined_state_is_never_armed(state: int) -> None:
    rig = _unmet(lambda: {"state": state})

    rig.run_for(500)

    assert rig.phase is Phase.FAULT
    assert (
        f"reports state {int(state)}, which the protocol does not define" in rig.loop.state.reason
    )
    assert "in fault" in rig.arm().error
    assert rig.ports.device.state is DeviceState.IDLE


def test_a_configuration_altered_during_transmission_is_rejected() -> None:
    rig = _unmet(lambda: {"config_crc": 1}, of=ConfigReply)

    rig.run_for(500)

    assert rig.phase is Phase.INIT
    assert any("another configuration" in log.message for log in rig.of(Log))


def test_a_starting_device_receives_the_request_again() -> None:
    booting = [True]
    rig = _unmet(lambda: {"state": DeviceState.BOOT} if booting[0] else {})

    rig.run_for(500)
    phase, device, state = rig.phase, rig.loop.state.device, rig.ports.device.state
    assert rig.arm().error == NO_DEVICE
    booting[0] = False
    rig.run_for(300)

    assert (phase, device, state) == (Phase.INIT, None, DeviceState.IDLE)
    assert rig.phase is Phase.SAFE
    assert rig.arm().error == ""


def test_a_device_without_a_recent_answer_is_not_armed() -> None:
    rig = Bench()
    stale_ns = rig.ports.now - 60_000_000
    rig.loop.state = changed(rig.loop.state, last_round_trip_ns=stale_ns)

    rig.order(Arm(order=9, owner="a student", lease=LEASE, ts_us=0))
    rig.loop._step(rig.ports.now, rig.ports.wait(rig.ports.now))

    rig.run_for(1)
    answer = rig.of(Answer)[-1]
    assert answer.error == "no answer from the device for 60 ms: try again"
    assert round(answer.parameters["age_ms"]) == 60


def test_samples_of_an_earlier_link_do_not_permit_arming() -> None:
    rig = Bench()
    newest_ns = rig.loop.state.sampled_ns
    rig.ports.send(rig.ports.now, LinkDown("pulled"))
    rig.ports.send(rig.ports.now, LinkUp())
    asked_ns = [rig.ports.now + n * 100_000 for n in range(1, 400)]
    for n, at_ns in enumerate(asked_ns):
        rig.order(Arm(order=n, owner="a student", lease=LEASE, ts_us=0), at_ns)

    rig.run_for(60)

    errors = [a.error for a in rig.of(Answer)]
    early = errors[: errors.index("")]
    refusals = [n for n, error in enumerate(early) if "no sample of the device" in error]
    assert refusals
    assert asked_ns[refusals[0]] - newest_ns < 50_000_000


@pytest.mark.parametrize(("longer_us", "paces"), [(0, True), (-1, False)])
def test_the_host_paces_at_the_ts_of_the_holder_if_the_line_is_fast_enough(
    longer_us: int, paces: bool
) -> None:
    """The shortest such Ts is the duration of an exchange; below it, the default Ts paces."""
    rig = Bench()
    ts_us = min_exchange_us(rig.loop.state.rules.baud, rig.loop.state.device.skew_us) + longer_us

    assert rig.arm(ts_us=ts_us).error == ""

    assert rig.loop.state.ts_us == (ts_us if paces else rig.loop.state.rules.ts_us)
