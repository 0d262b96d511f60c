"""Oversampling and CAL in virtual time: what the rules of `conformance/` do not reach."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest
from armrig_daemon.emulator.requests import statistics
from armrig_daemon.emulator.sensors import mean
from armrig_protocol import messages as wire
from armrig_protocol.messages import Flag, Mode, State
from hypothesis import given
from hypothesis import strategies as st

from tests.daemon.emulator.emulated_host import (
    CONVERSION_NS,
    HOLD_NS,
    MS,
    SAMPLE_NS,
    US,
    Host,
    only,
)

CAL_REPLY_NS = 260 * US  # 26 bytes at 1 Mbaud


def reading(host: Host, theta_1: Iterable[int], alpha: Iterable[int]) -> list[tuple[str, int]]:
    """Let the converter read these codes in turn; return the readings, and their times."""
    read: list[tuple[str, int]] = []
    turns = iter(theta_1), iter(alpha)

    def take(channel: int, t_ns: int) -> int:
        read.append((("theta_1", "alpha")[channel], t_ns))
        return next(turns[channel])

    host.device.board.reading = take  # type: ignore[method-assign]
    return read


# ------------------------------------------------------------------ oversampling


@pytest.mark.parametrize("m", [1, 2, 3, 8])
def test_conversions_alternate_and_the_last_of_theta_1_precedes_the_latch(m: int) -> None:
    """t_us is its trigger; the first conversion was 2 m - 1 conversions before, at EXCHANGE."""
    host = Host().reach(State.RUN, ts_us=5000, oversampling=m)
    read = reading(host, range(1000, 1000 + m), range(2000, 2000 + m))
    host.changes.clear()

    t_ns = host.put(wire.Exchange, k=1, u=30_000)
    sample = only(wire.Sample, host.wait(10 * MS))

    held = [t_ns + i * CONVERSION_NS + HOLD_NS for i in range(2 * m)]
    assert read == [(("alpha", "theta_1")[i % 2], held[i]) for i in range(2 * m)]
    assert sample.t_us == (t_ns + (2 * m - 1) * CONVERSION_NS) // 1000
    assert [c.t_ns for c in host.changes] == [held[-1]]
    assert host.heard[-1].t_ns == t_ns + 2 * m * CONVERSION_NS + SAMPLE_NS
    half_up = m // 2 if m % 2 == 0 else (m - 1) // 2
    assert (sample.y0, sample.y1) == (1000 + half_up, 2000 + half_up)


@pytest.mark.parametrize("m", [1, 3])
def test_the_timer_s_tick_is_theta_1_s_last_trigger(m: int) -> None:
    """Sample k is at t_0 + k Ts for any m."""
    host = Host().reach(State.ARMED, mode=Mode.SCHEDULED, ts_us=1000, oversampling=m)
    t_0 = host.put(wire.Start, k_stop=3) + 1000 * US
    read = reading(host, [1000] * 3 * m, [2000] * 3 * m)

    got = [one for one in host.wait(8 * MS) if isinstance(one, wire.Sample)]

    assert [one.t_us for one in got] == [t_0 // 1000 + k * 1000 for k in range(3)]
    assert read[0] == ("alpha", t_0 - (2 * m - 1) * CONVERSION_NS + HOLD_NS)
    assert read[2 * m - 1] == ("theta_1", t_0 + HOLD_NS)
    assert not any(one.flags & Flag.TICK_LATE for one in got)


def test_readings_are_not_averaged_across_the_dead_band() -> None:
    assert mean([65_000, 64_900, 0, 700]) == 700
    assert mean([64_900, 0, 0]) == 0
    assert mean([65_472, 500]) == 500
    assert mean([65_471, 500]) == 32_986
    assert mean([64, 64]) == 64
    assert mean([63, 100]) == 100


@given(st.lists(st.integers(64, 65_471), min_size=1, max_size=255))
def test_the_mean_is_the_nearest_code(read: list[int]) -> None:
    assert 0 <= 2 * (mean(read) * len(read) - sum(read)) + len(read) - 1 < 2 * len(read)


# ------------------------------------------------------------------ CAL


@pytest.mark.parametrize("channel", [0, 1])
@pytest.mark.parametrize("state", [State.IDLE, State.READY])
def test_cal_reads_one_channel_n_times(state: State, channel: int) -> None:
    host = Host().reach(state, ts_us=5000, oversampling=4)
    read = reading(host, [100, 200, 300, 401], [5, 6, 7, 8])

    t_ns = host.put(wire.Cal, channel=channel, zero=0, n=4)
    reply = only(wire.CalReply, host.wait(3 * MS))

    name = ("theta_1", "alpha")[channel]
    assert read == [(name, t_ns + i * CONVERSION_NS + HOLD_NS) for i in range(4)]
    assert host.heard[-1].t_ns == t_ns + 4 * CONVERSION_NS + CAL_REPLY_NS
    assert (reply.state, reply.channel, reply.zero, reply.n) == (state, channel, 0, 4)
    assert (reply.least, reply.greatest) == ((100, 401), (5, 8))[channel]
    mean_256 = (100 + 200 + 300 + 401) * 64, (5 + 6 + 7 + 8) * 64
    assert reply.mean_256 == mean_256[channel]


@given(st.lists(st.integers(0, 65_535), min_size=2, max_size=40))
def test_cal_reports_mean_and_variance_in_256ths(read: list[int]) -> None:
    """Rounded; the variance is over n - 1."""
    found = statistics(read)

    assert abs(found.mean_256 / 256 - np.mean(read)) <= 1 / 512 + 1e-6
    variance = float(np.var(read, ddof=1))
    assert abs(found.variance_256 - min(256 * variance, 2**32 - 1)) <= 0.51 + 1e-9 * variance


def test_the_variance_is_bounded_and_that_of_one_reading_is_0() -> None:
    """2^32 - 1 is the maximum of the field."""
    assert statistics([0, 65_535]).variance_256 == 2**32 - 1
    assert statistics([7]) == (7 * 256, 0, 7, 7)


def test_a_reset_discards_an_unfinished_cal() -> None:
    host = Host()
    host.put(wire.Cal, channel=0, zero=0, n=300)
    host.wait(2 * MS)

    host.device.reset(host.now_ns)

    assert not any(isinstance(m, wire.CalReply) for m in host.wait(100 * MS))
    only(wire.Sample, host.ask(wire.Exchange, k=1, u=0))
    assert host.ask(wire.Hello, version=2, schema=0)


def test_visible_time_of_cal_is_its_end() -> None:
    host = Host()
    host.put(wire.Cal, channel=0, zero=0, n=300)
    host.wait(2 * MS)

    due_ns = host.device.visible_ns()
    host.wait(100 * MS)

    (answer,) = [heard for heard in host.heard if isinstance(heard.message, wire.CalReply)]
    assert host.now_ns - 75 * MS < due_ns <= answer.t_ns
