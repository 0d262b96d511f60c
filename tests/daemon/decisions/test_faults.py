"""Each fault has an id, a cause, the state of the motor, and a remedy."""

from __future__ import annotations

import re

import pytest
from armrig_core.rig.emulated import EMULATOR_UID
from armrig_core.telemetry import protobuf
from armrig_daemon.config import Config, DeviceTable
from armrig_daemon.decisions.faults import (
    REMEDIES,
    REMEDIES_OF_EMULATED,
    Fault,
    Id,
    of_device,
    remedy,
)
from armrig_daemon.decisions.outcomes import report_state, silence_cause
from armrig_daemon.decisions.stopping import trip
from armrig_daemon.pipe import Log, State
from armrig_daemon.service.protobuf_out import outgoing
from armrig_protocol.messages import Cause
from msgspec.structs import replace

from tests.daemon.virtual_bench import Bench


@pytest.fixture
def driven() -> Bench:
    """Return a rig whose motor turns under a hand."""
    bench = Bench()
    bench.arm()
    bench.drive(2.0, 1)
    return bench


def test_every_fault_has_its_remedy() -> None:
    assert set(REMEDIES) == set(Id)


@pytest.mark.parametrize("fault", Id)
def test_the_remedy_for_an_emulated_rig_names_no_cable(fault: Id) -> None:
    said = remedy(fault, is_emulated=True)

    assert not re.search(r"cable|\bplug|unplug|supply|baud|wire|flash", said)
    assert remedy(fault, is_emulated=False) == REMEDIES[fault]


@pytest.mark.parametrize(
    ("port", "uid", "wanted"),
    [
        ("unix:/run/emulator", 1, REMEDIES_OF_EMULATED[Id.STALE]),
        ("/dev/pts/3", EMULATOR_UID, REMEDIES_OF_EMULATED[Id.STALE]),
        ("/dev/ttyACM0", 1, REMEDIES[Id.STALE]),
    ],
)
def test_the_port_or_the_device_decides_whether_the_remedy_is_that_of_an_emulated_rig(
    port: str, uid: int, wanted: str, driven: Bench
) -> None:
    rules = Config(device=DeviceTable(port=port)).rules()
    state = replace(driven.loop.state, rules=rules, device_uid=uid)

    tripped, actions = trip(state, 0, Fault(Id.STALE, "silent"))
    gone = replace(tripped, device=None)  # the device is unknown after the fault

    assert any(wanted in str(action) for action in actions)
    assert wanted in str(report_state(gone, 0))
    is_real = wanted == REMEDIES[Id.STALE]
    assert ("plugged in" in silence_cause(replace(gone, link=None))) == is_real


@pytest.mark.parametrize(
    ("cause", "words"),
    [
        (Cause.WATCHDOG, "received nothing"),
        (Cause.RANGE, "voltage was outside"),
        (Cause.SLEW, "limits.slew_v"),
        (Cause.ADC_RAIL, "device.rail_ticks"),
        (Cause.REV_LIMIT, "limits.revolutions"),
        (Cause.UNDERRUN, "setpoints"),
        (Cause.VCC_LOW, "supply"),
        (Cause.INTERNAL, "internal check"),
    ],
)
def test_a_fault_of_the_device_is_reported_with_its_name_and_meaning(
    cause: Cause, words: str
) -> None:
    said = of_device(cause)

    assert said.startswith(f"{cause.name}, ")
    assert words in said
    assert [said] == [text for text in map(of_device, Cause) if words in text]


def test_a_cause_without_a_fault_or_of_a_later_protocol_has_no_meaning() -> None:
    faults = {Cause.WATCHDOG, *range(Cause.RANGE, 13)}
    rest = [c for c in Cause if c not in faults]

    assert [of_device(c) for c in rest] == [c.name for c in rest]
    assert of_device(200) == "200"


def test_a_fault_is_reported_with_its_reason_its_remedy_and_the_motor(driven: Bench) -> None:
    driven.run_for(400)

    told = [s for s in driven.of(State) if s.fault]
    assert {s.fault for s in told} == {"lease"}
    assert told[0].motor == "stop sent, not confirmed yet"
    assert told[-1].motor == "at 0 V, as the device reports"
    assert told[-1].reason == "the lease ran out: no command from its holder"
    assert told[-1].remedy == REMEDIES[Id.LEASE]
    (log,) = [e for e in driven.of(Log) if e.level == "error"]
    assert log.message == (
        f"stopped at 0 V: {told[-1].reason}; {told[-1].remedy}; then `armrig reset`, then repeat"
    )


def test_the_state_message_contains_the_fault(driven: Bench) -> None:
    driven.run_for(400)
    record = driven.of(State)[-1]

    message = protobuf.message_class(protobuf.STATE).FromString(outgoing(record, 0).data)

    assert (message.fault, message.motor, message.remedy) == (
        record.fault,
        record.motor,
        record.remedy,
    )
