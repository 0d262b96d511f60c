"""Messages of a service at its limits; the words are in `service/said.txt`."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any

from armrig_core.commands.codes import Ending, GapCode, OutcomeCode
from armrig_core.commands.commands import Renew, RunRequest
from armrig_core.telemetry import protobuf
from armrig_core.telemetry.channels import CHANNELS, SAMPLE_FIELDS
from armrig_core.telemetry.history import decode_past
from armrig_core.telemetry.telemetry import Sample
from armrig_daemon.config import Config
from armrig_daemon.pipe import Clock, Distribution, Gap, Log, State, Timing, Trace
from armrig_daemon.service import admission, client_watchdog, readings
from armrig_daemon.service.access import Network
from armrig_daemon.service.host import pressure
from armrig_daemon.service.plan import check_voltages, one_a_line
from armrig_daemon.service.protobuf_out import outgoing
from armrig_daemon.service.publish import History
from armrig_daemon.service.runs import part_samples
from armrig_daemon.service.sentences import (
    endpoint_error,
    network_error,
    network_notice,
    startup_sentence,
    state_sentence,
    unreachable,
)
from armrig_daemon.service.thinning import Thinning
from armrig_protocol.messages import Flag
from msgspec.structs import replace

from tests.daemon.odd_bench import CONFIG

__all__ = [
    "CONFIG",
    "Config",
    "check_voltages",
    "ended",
    "endpoint_error",
    "late",
    "network_error",
    "odd_history",
    "odd_log",
    "odd_messages",
    "odd_networks",
    "odd_questions",
    "odd_readings",
    "odd_signs",
    "odd_state",
    "one_a_line",
    "part_samples",
    "startup_sentence",
    "state_sentence",
    "unreachable",
    "untimely",
]


def odd_state(**changes: Any) -> State:
    """Return the state of a rig that Ada has."""
    state = State(t_host_ns=5, phase="armed", reason="", owner="Ada\n", ts_us=8_000, device={})
    return replace(state, **changes)


def untimely(timing: Timing | None, watchdog_ms: int, load: str) -> str:
    """Return the reason why a host must not drive a motor, in words."""
    refusal = pressure.untimely(timing, watchdog_ms, load)
    return refusal.error if refusal else ""


def late(p99_us: float) -> Timing:
    """Return a second in which the host was so late, as a rule less."""
    wake = Distribution(p50=1.0, p90=2.0, p99=p99_us, p999=1e6, max=1e6, n=99, missed=3)
    return Timing(
        t_host_ns=1,
        wake_lateness_us=wake,
        device_tick_error_us=wake,
        link_round_trip_us=wake,
        queue_depth=wake,
    )


def ended(code: str, **state: Any) -> str:
    """Return the sentence of a run with this end, on a loaded host in this state."""
    return pressure.with_load(Ending(OutcomeCode(code), "late"), odd_state(**state), "load 2").text


def odd_networks() -> None:
    """Print who may come over networks whose certificates count for a month, and not quite."""
    now = datetime(2026, 3, 1, 12, tzinfo=UTC)
    for days, is_router in ((31, False), (30, True)):
        network = Network(
            endpoint="tls/h:7447",
            operators=2,
            observers=5,
            expires=now + timedelta(days=days),
            is_router=is_router,
            **NETWORK,
        )
        print(network_notice(network, now))


NETWORK: dict[str, Any] = {
    "access_control": {},
    "low_pass_filter": [],
    "tls": {},
}


def _sample(k: int, **changes: Any) -> Sample:
    plain = Sample(*(0 for _ in SAMPLE_FIELDS))
    times = {"k": k, "t_host_ns": k * 8_000_000, "t_device_us": k * 8_000}
    return plain._replace(**{**times, "counts_1": 30_000, **changes})


def odd_readings() -> None:
    """Print what objects to an arming: a theta_1 that stands still, an alpha at its rail."""

    def objections(changes: dict[str, Any], until: range) -> None:
        known = readings.ReadingSummary()
        for k in range(until.stop):
            known = readings.update_readings(
                known, _sample(k, **changes, counts_0=500 + k % 2 * 256)
            )
            if k in until:
                refusal = readings.objection(known, CHANNELS, turns_per_volt_s=0.4)
                told = refusal.error if refusal else "may be armed"
                print(k, told, readings.start_rad(known), round(known.volt_s, 6))

    unread = readings.objection(readings.ReadingSummary(), CHANNELS, turns_per_volt_s=0.4)
    print(unread.error if unread else "")
    objections({"u_applied_v": 3.5}, range(124, 127))
    objections({"u_applied_v": 1.0}, range(200, 201))
    objections({"flags": int(Flag.ADC1_RAIL), "value_0": float("nan")}, range(24, 27))
    apart = readings.update_readings(readings.ReadingSummary(), _sample(1, u_applied_v=4.0))
    for k in (26, 52):  # 0.2 s, and 8 ms more
        apart = readings.update_readings(apart, _sample(k, u_applied_v=4.0))
        print(k, round(apart.volt_s, 6))
    moved = readings.update_readings(apart, _sample(53, counts_0=257))
    print(moved.volt_s, moved.least, moved.greatest)


def odd_log() -> None:
    """Print the lines of a log with numbers: at once, and in each second afterwards."""
    thinning = Thinning()

    def log(ms: int, message: str, level: str = "warning", **fields: str) -> None:
        line = Log(t_host_ns=ms * 1_000_000, level=level, message=message, fields=fields)
        if thinning.lets_through(line):
            print(ms, level, message)

    def due(ms: int, *, end: bool = False) -> None:
        for line in thinning.due(ms * 1_000_000, end=end):
            print(ms, "due:", line.t_host_ns, line.message)

    for ms in (0, 300, 900):
        log(ms, f"late by {ms / 10} ms")
    log(910, "stop: by group 3", "info", command="stop")
    log(911, "stop: by group 4", "info", command="stop")
    log(912, "late by 9 ms", "error")
    due(999)
    due(1000)
    log(1500, "late by 150 ms")
    due(1899)
    due(1900)
    due(2500)
    log(3600, "late by 1 ms")
    log(3700, "late by 2 ms")
    due(3701, end=True)


def odd_signs() -> None:
    """Print until when a client is there, by its signs."""
    run = RunRequest(lease="a" * 32, n=3, u=[1.0], dead_man=2.5)
    there = client_watchdog.begin_watch(run, 100.0)
    print(there.gone_s, client_watchdog.begin_watch(replace(run, dead_man=None), 100.0).gone_s)
    for lease, n, has_run in (("a", 4, True), ("b", 5, True), ("a", 4, True), ("a", 5, False)):
        try:
            sign = Renew(lease=lease * 32, n=n)
            there = client_watchdog.renew_watch(there if has_run else None, sign, 101.25)
            print(there.gone_s)
        except ValueError as err:
            print(err)


def odd_questions() -> None:
    """Print how many of a flood are answered at once, after 0.1 s, and after an hour."""
    bucket = admission.Bucket(at_s=50.0)
    for now_s in (50.0, 50.1, 50.102, 3650.0):
        taken = 0
        while (
            after := admission.take(bucket, now_s, admission.PER_S, admission.BURST)
        ) is not None:
            bucket, taken = after, taken + 1
        print(now_s, taken)
    print(admission.too_many("status"))


def odd_history() -> None:
    """Print the kept messages of 40 B for a limit of 100 B."""
    history = History(bytes(range(16)), most_bytes=100)
    for n in range(5):
        history.add("sample" if n % 2 else "gap", bytes([n]) * 40)
    for first in (0, 3, 4, 5, 99):
        past = decode_past(history.reply(first, 77))
        shown = [(stream, data[0], len(data)) for stream, data in past.messages]
        print(first, past.first, past.clock_offset_ns, shown)


def odd_records() -> tuple[Timing, State, Clock, Gap, Log, Trace]:
    """Return a record of each kind that is published or recorded."""
    part = Distribution(p50=1.5, p90=2.5, p99=3.5, p999=4.5, max=5.5, n=6, missed=7)
    timing = Timing(
        t_host_ns=3,
        wake_lateness_us=part,
        device_tick_error_us=replace(part, p50=11.0),
        link_round_trip_us=replace(part, p50=12.0),
        queue_depth=replace(part, p50=13.0),
        collections=8,
        cpu_pressure_percent=9.5,
        run_queue=10,
    )
    state = odd_state(reason="r", fault="f", motor="m", remedy="y", device={"uid": "7"})
    clock = Clock(
        t_host_ns=4,
        offset_ns=-5,
        offset_std_ns=6.5,
        drift_ppm=-7.5,
        drift_std_ppm=8.5,
        bound_ns=9.5,
    )
    gap = Gap(
        k_first=2,
        count=3,
        t_from_ns=4,
        t_to_ns=5,
        u_held_v=0.5,
        reason="late",
        code=GapCode.HOST_LATE,
    )
    log = Log(t_host_ns=6, level="debug", message="hello", fields={"a": "b"})
    trace = Trace(t_host_ns=7, number=8, state=b"s", steps=b"t", version=2)
    return timing, state, clock, gap, log, trace


def odd_messages() -> None:
    """Print the published messages of each kind of record."""
    for record in odd_records():
        made = outgoing(record, 1_000_000_000_000)
        name = protobuf.TRACE if made.stream == "trace" else protobuf.OF_STREAM[made.stream]
        message = protobuf.message_class(name).FromString(made.data)
        print(*made[:4], " ".join(str(message).split()))
