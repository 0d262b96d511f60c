"""A measured output outside its limits, or unknown for too long, stops the motor; it is latched."""

from __future__ import annotations

from math import inf, nan
from typing import Any

import msgspec
import pytest
from armrig_core.commands.codes import RefusalCode
from armrig_core.rig.description import Description, builtin
from armrig_core.rig.volts import code_of
from armrig_daemon.config import ArmSettings, Config, DeviceTable, Limits, TimingTable, load
from armrig_daemon.decisions.output_limits import blind, observe
from armrig_daemon.decisions.state import OutputLimit, Phase, Rules
from armrig_daemon.pipe import Log, Reset, Run, RunEnded, Set
from msgspec import UNSET
from msgspec.structs import replace

from tests.daemon.virtual_bench import LEASE, MS, Bench, codes

TEXT = """
[rig]
name = "two"
[outputs.T1]
unit = "mm"
per_count = 1.0
low = 10000
high = 50000
samples = 3
blind_s = 0.1
[outputs.T2]
unit = "K"
per_count = -1.0
low = -40000
"""
TWO = Description.of(TEXT.encode())
RAIL = 65_472
Readings = list[int]


def _bench(*, Ts: float = 0.01) -> Bench:
    """Return an armed rig whose readings are inside their limits."""
    bench = Bench(Config(timing=TimingTable(Ts=Ts)), description=TWO)
    _read(bench, 30_000, 30_000)
    bench.run_for(50)
    assert not bench.arm().error
    return bench


def _read(bench: Bench, first: int, second: int) -> None:
    """Let the sensors read these counts from now on."""
    board: Any = bench.ports.device.board
    board.reading = lambda channel, _: (first, second)[channel]


def _driven(bench: Bench, way: str) -> None:
    if way == "by hand":
        assert not bench.drive(2.0, 1).error
    else:
        run = {"run_id": "r", "codes": codes(*[2.0] * 500), "scheduled": way == "scheduled"}
        assert not bench.ask(Run, lease=LEASE, n=1, **run).error
    assert bench.volts


def _until_rest(bench: Bench) -> float:
    """Return the time until the motor is at 0 V, in ms."""
    began = bench.ports.now
    while bench.ports.now < began + 400 * MS:
        bench.run_for(1)  # at least to the next event of the loop
        if not bench.volts:
            return (bench.ports.now - began) / MS
    return inf


@pytest.mark.parametrize("way", ["by hand", "exchange", "scheduled"])
@pytest.mark.parametrize(
    ("readings", "cause", "samples"),
    [
        ((50_001, 30_000), "T1 = 50001 mm is above 50000 mm", 3),
        ((9_999, 30_000), "T1 = 9999 mm is below 10000 mm", 3),
        ((30_000, 40_001), "T2 = -40001 K is below -40000 K", 2),
    ],
)
def test_samples_outside_the_limits_stop_the_motor_at_the_last_of_them(
    way: str, readings: tuple[int, int], cause: str, samples: int
) -> None:
    bench = _bench()
    _driven(bench, way)
    if way == "by hand":
        bench.order(Set(order=99, lease=LEASE, n=2, code=code_of(2.0)))  # renews the lease
        bench.run_for(1)

    _read(bench, *readings)
    took_ms = _until_rest(bench)

    # The first sample may be due at once; the STOP needs the time of two frames and of a reading.
    assert (samples - 1) * 10 - 1 <= took_ms <= samples * 10 + 4
    fault = bench.loop.state.fault
    assert fault is not None
    assert (str(fault.id), fault.cause, fault.output) == ("output", cause, cause[:2])
    logged = next(log for log in bench.of(Log) if log.fields.get("cause") == "output")
    assert logged.fields["output"] == cause[:2]
    bench.run_for(100)
    if way != "by hand":
        assert bench.of(RunEnded)[-1].outcome == cause


def test_a_fault_of_an_output_is_latched_and_prevents_arming_until_it_is_back() -> None:
    bench = _bench()
    _read(bench, 60_000, 30_000)
    bench.run_for(100)

    assert bench.phase is Phase.FAULT
    assert bench.arm().code == RefusalCode.IN_FAULT
    assert not bench.ask(Reset).error
    refused = bench.arm()
    assert (refused.code, refused.parameters) == (RefusalCode.READINGS, {"output": "T1"})
    assert "smaller or shorter input" in refused.error

    _read(bench, 50_000, 40_000)  # the limits belong to the range
    bench.run_for(50)
    assert not bench.arm().error
    _driven(bench, "scheduled")
    bench.run_for(300)
    assert bench.phase is Phase.ACTIVE


@pytest.mark.parametrize("way", ["exchange", "scheduled"])
def test_an_output_at_a_rail_for_its_blind_time_stops_the_motor(way: str) -> None:
    bench = _bench()
    _driven(bench, way)

    _read(bench, RAIL, 30_000)
    took_ms = _until_rest(bench)

    assert 90 <= took_ms <= 125
    fault = bench.loop.state.fault
    assert fault is not None
    assert (str(fault.id), fault.output, fault.value) == ("blind", "T1", 30_000)
    assert bench.ask(Reset).error == ""
    assert bench.arm().error.startswith("T1 has had no valid sample for ")


def test_an_output_without_a_blind_time_may_be_at_a_rail() -> None:
    bench = _bench()
    _driven(bench, "scheduled")
    _read(bench, 30_000, RAIL)

    assert _until_rest(bench) == inf


LIMIT = OutputLimit(0, "T", "K", 0.0, 10.0, 3, 100 * MS)


@pytest.mark.parametrize(
    ("values", "count"),
    [
        ([11.0, 11.0], 2),
        ([10.0, 0.0], 0),
        ([11.0, 5.0, -0.1], 1),
        ([11.0, nan, 11.0], 2),
        ([11.0, nan, nan], 1),
        ([nan, nan], 0),
        ([11.0] * 9, 3),
    ],
)
def test_only_a_valid_sample_inside_begins_the_count_again(values: list[float], count: int) -> None:
    bench = _bench()
    state, sample = replace(bench.loop.state, watch=UNSET), bench.samples[-1]

    for i, value in enumerate(values):
        one = sample._replace(value_0=value, t_host_ns=i * MS)
        state, outcomes = observe(state, (LIMIT,), one)
        assert bool(outcomes) == (count == 3 and i >= 2)

    assert state.watch
    known = state.watch[0]
    assert known.outside == count
    valid = [i for i, value in enumerate(values) if value == value] or [0]
    assert known.valid_ns == valid[-1] * MS
    assert blind((LIMIT,), state.watch, (valid[-1] + 100) * MS, 0) is None
    assert blind((LIMIT,), state.watch, (valid[-1] + 100) * MS + 1, 0) is not None


def test_a_rig_that_is_not_driven_is_observed_without_a_trip() -> None:
    bench = Bench(description=TWO)
    _read(bench, 60_000, 30_000)
    bench.run_for(200)

    assert bench.phase is Phase.SAFE
    assert bench.loop.state.watch[0].outside == 3
    assert bench.arm().code == RefusalCode.READINGS


def test_a_sampling_time_that_does_not_fit_the_blind_time_is_refused(tmp_path: Any) -> None:
    bench = Bench(description=TWO)
    _read(bench, 30_000, 30_000)
    bench.run_for(50)

    said = "blind_s = 0.1 of T1 is too short for Ts = 0.05 s: at least 0.25 s"
    assert bench.arm(ts_us=50_000).error == said
    (tmp_path / "two.toml").write_text(TEXT)
    file = {"rig": {"file": str(tmp_path / "two.toml")}}
    with pytest.raises(ValueError, match=said):
        load([], {}, file | {"timing": {"Ts": 0.05}})


def test_the_rules_of_a_described_rig_reach_the_process_of_the_loop() -> None:
    """As JSON, which has neither infinite numbers nor NaN."""
    for rig in (TWO, *map(builtin, ("arm", "chassis", "heater", "rc"))):
        rules = Config().rules(rig)

        assert msgspec.json.decode(msgspec.json.encode(rules), type=Rules) == rules


def test_limits_of_the_configuration_are_limits_of_the_arms_channels() -> None:
    config = Config(limits=Limits(revolutions=2.5, alpha_rad=0.8))
    alpha = OutputLimit(1, "alpha", "rad", -0.8, 0.8, 2, 1000 * MS, blind_grows=True)

    assert (config.rules().limits, config.rules().turns) == ((alpha,), 250)
    narrower = builtin("arm").text.replace(b"turning", b"turns = 1.5\nturning")
    narrower = narrower.replace(b'"arm"\n\n', b'"arm"\nhigh = 0.5\n\n')
    rules = config.rules(Description.of(narrower))
    assert (rules.turns, rules.limits) == (150, (replace(alpha, high=0.5),))
    alone = replace(config, arm=ArmSettings(removed=True)).rules()
    for rules in (alone, config.rules(builtin("chassis"))):
        assert (rules.limits, rules.turns) == (UNSET, 250)
    for key in ("revolutions", "alpha_rad"):
        with pytest.raises(
            ValueError, match=f"limits.{key} is for the arm: give rig two limits by"
        ):
            Config(limits=Limits(**{key: 1.0})).rules(TWO)


@pytest.mark.parametrize("way", ["exchange", "scheduled"])
def test_a_deflection_above_its_limit_stops_the_arm(way: str) -> None:
    bench = Bench(Config(limits=Limits(alpha_rad=0.8)))
    _read(bench, 30_000, 32_768)
    bench.run_for(50)
    assert not bench.arm().error
    _driven(bench, way)

    _read(bench, 30_000, 32_768 - 8_600)

    assert _until_rest(bench) <= 24
    fault = bench.loop.state.fault
    assert fault is not None
    assert fault.cause == "alpha = -0.806192 rad is below -0.8 rad"


def test_a_description_without_limits_gives_the_core_none() -> None:
    for name in ("arm", "chassis", "rc"):
        assert Config().rules(builtin(name)).limits is UNSET
    heater = Config().rules(builtin("heater")).limits
    assert heater == (
        OutputLimit(0, "T1", "degC", None, 70.0, 2, 10_000 * MS),
        OutputLimit(1, "T2", "degC", None, 70.0, 2, 1000 * MS, blind_grows=True),
    )


FULL = """
[rig]
name = "full"
[outputs.T1]
unit = "mm"
per_count = 1.0
high = 64000
[outputs.T2]
unit = "K"
per_count = -1.0
valid_rail = "low"
"""


@pytest.mark.parametrize(
    ("readings", "rail_ticks", "cause"),
    [
        ((65_535, 30_000), 0, "T1 reads the end of its range, which counts as above 64000 mm"),
        ((0, 30_000), 0, "T1 has had no valid sample for "),
        ((0, 30_000), 7, "T1 read an end of its range in 7 samples"),
        ((30_000, 0), 7, ""),
        ((30_000, 65_535), 0, ""),
        ((30_000, 65_535), 7, "T2 read an end of its range in 7 samples"),
    ],
)
def test_each_end_of_a_range_is_what_the_description_says(
    readings: tuple[int, int], rail_ticks: int, cause: str
) -> None:
    """Only a limit's own end is outside, and a valid end never stops the motor."""
    config = Config(device=DeviceTable(rail_ticks=rail_ticks), timing=TimingTable(Ts=0.01))
    bench = Bench(config, description=Description.of(FULL.encode()))
    _read(bench, 30_000, 30_000)
    bench.run_for(50)
    assert not bench.arm().error
    assert not bench.ask(Run, lease=LEASE, n=1, run_id="r", codes=codes(*[2.0] * 200)).error

    _read(bench, *readings)
    bench.run_for(1200)

    fault = bench.loop.state.fault
    assert (fault.cause if fault else "").startswith(cause)
    assert bool(fault) == bool(cause)
    assert bench.loop.state.rules.rail_ticks == 0
