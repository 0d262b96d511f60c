"""The device's clock is found from PING and PONG, and the standard deviations can be believed."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from random import Random

import pytest
from armrig_daemon.decisions.clockmap import (
    ClockMap,
    LinkTiming,
    estimate,
    host_ns_at,
    start,
    std_ns_at,
    update,
)

from tests.sampling import sampled

LINK = LinkTiming(request_ns=180_000, answer_ns=260_000)  # 18 and 26 bytes at 1 Mbaud
BOOT_NS = 1_700_000_000_123_456  # 20 days of a monotonic clock
QUEUES_US = [(20.0, 200.0), (200.0, 20.0), (100.0, 100.0), (1.0, 200.0)]
Exchange = tuple[int, int, int, int]


@dataclass(kw_only=True)
class Rig:
    """A device with its own clock and a link that delays request and answer."""

    seed: int
    wait_us: tuple[float, float] = (20.0, 200.0)
    """Means of the exponential waiting times of request and answer."""
    drift_ppm: float = 0.0
    """Slowness of the device's clock, in ppm."""
    drift_per_s: float = 0.0
    """Rate of change of the drift, in ppm/s."""
    first_us: float = 12_345_678.0
    """Time of the device's clock at the start, in µs."""
    resolution_us: int = 1
    stall_ns: int = 0
    """Stall of one answer, or one request, in ten, in ns."""
    gap_s: float = 0.1
    link: LinkTiming = LINK

    def __post_init__(self) -> None:
        self.random = Random(self.seed)
        self.t_ns = BOOT_NS + self.random.randrange(10**9)
        self.t0_ns = self.t_ns

    def device_us(self, host_ns: float) -> int:
        """Return the time of the device's clock."""
        t_us = (host_ns - self.t0_ns) / 1000
        slow = self.drift_ppm * 1e-6 * t_us + self.drift_per_s * 1e-12 * t_us * t_us / 2
        return int((self.first_us + t_us - slow) // self.resolution_us) * self.resolution_us

    def exchanges(self) -> Iterator[Exchange]:
        """Yield the four stamps, ten times a second or so, for ever."""
        while True:
            waits = [1000 * self.random.expovariate(1 / mean) for mean in self.wait_us]
            if self.random.random() < 0.1:
                waits[self.random.randrange(2)] += self.stall_ns
            rx_ns = self.t_ns + self.link.request_ns + waits[0]
            tx_ns = rx_ns + 1000 * self.random.uniform(5, 60)
            h4_ns = int(tx_ns + self.link.answer_ns + waits[1])
            yield self.t_ns, self.device_us(rx_ns), self.device_us(tx_ns), h4_ns
            gap_ns = int(1e9 * self.random.uniform(0.9, 1.1) * self.gap_s)
            self.t_ns = max(h4_ns, self.t_ns + gap_ns)


def follow(rig: Rig, n: int, clock: ClockMap | None = None) -> ClockMap:
    """Return the map after n exchanges."""
    clock = clock or start(rig.link._replace(resolution_us=rig.resolution_us))
    for exchange in islice(rig.exchanges(), n):
        clock = update(clock, *exchange)
    return clock


def error_ns(rig: Rig, clock: ClockMap, ahead_ns: int = 0) -> tuple[float, float]:
    """Return the map's error at the present, or later, and its own deviation."""
    at_ns = rig.t_ns + ahead_ns
    device_us = rig.device_us(at_ns)
    host_ns, std_ns = host_ns_at(clock, device_us), std_ns_at(clock, device_us)
    return host_ns - at_ns, std_ns


def rms(values: list[float]) -> float:
    """Return the root mean square."""
    return math.sqrt(sum(v * v for v in values) / len(values))


@pytest.mark.parametrize(
    ("wait_us", "drift_ppm"),
    sampled(zip(QUEUES_US, (100.0, -100.0, -100.0, 100.0), strict=True), 2),
)
def test_drift_and_offset_lie_within_their_reported_deviations(
    wait_us: tuple[float, float], drift_ppm: float
) -> None:
    """One-sided waiting times of any distribution; 50 seeds."""
    offsets, drifts, errors_us, stds_us = [], [], [], []
    for seed in range(50):
        rig = Rig(seed=seed, wait_us=wait_us, drift_ppm=drift_ppm)
        clock = follow(rig, 600)
        error, std = error_ns(rig, clock)
        found = estimate(clock)
        offsets.append(abs(error) < 3 * std)
        drifts.append(abs(found.drift_ppm - drift_ppm) < 3 * found.drift_std_ppm)
        errors_us.append(error / 1000)
        stds_us.append(std / 1000)
        assert found.drift_std_ppm < 1.5
        assert abs(found.drift_ppm - drift_ppm) < 0.4

    assert sum(offsets) >= 48
    assert sum(drifts) >= 48
    # Believable, not only safe: a deviation of a second would cover all.
    assert rms(errors_us) < 4
    assert 0.15 < rms(errors_us) / rms(stds_us) < 1.5


@pytest.mark.parametrize("n", [1, 2, 3, 5, 8, 12, 20, 50])
def test_clock_map_of_few_exchanges_has_a_large_deviation(n: int) -> None:
    within = 0
    for seed in range(100):
        rig = Rig(seed=seed, drift_ppm=100)
        error, std = error_ns(rig, follow(rig, n))
        within += abs(error) < 3 * std

    assert within >= 95


def test_clock_map_corrects_the_known_asymmetry_of_the_wire() -> None:
    """A longer answer on a slow wire leaves no offset: 18 and 26 bytes at 9600 baud."""
    link = LinkTiming(request_ns=18_750_000, answer_ns=27_083_333)

    rig = Rig(seed=1, wait_us=(1.0, 1.0), link=link)
    right, _ = error_ns(rig, follow(rig, 300))
    wrong, _ = error_ns(rig, follow(rig, 300, start(LinkTiming())))

    assert abs(right) < 1500
    assert wrong == pytest.approx((27_083_333 - 18_750_000) / 2, abs=1500)


def test_clock_map_bounds_an_unknown_asymmetry() -> None:
    """A constant delay one way stays in the offset, at most half the least round trip."""
    rig = Rig(seed=1, wait_us=(1.0, 1.0), link=LinkTiming(request_ns=180_000, answer_ns=1_260_000))

    clock = follow(rig, 300, start(LINK))

    error, std = error_ns(rig, clock)
    assert error == pytest.approx(500_000, abs=2000)
    assert abs(error) - 3 * std < estimate(clock).bound_ns < 502_000


def test_clock_map_of_a_coarse_device_clock_has_a_larger_deviation() -> None:
    """A step of 4 µs does not average out."""
    rig = Rig(seed=2, wait_us=(0.1, 0.1), resolution_us=4)

    error, std = error_ns(rig, follow(rig, 1200))

    assert std > 4000 / math.sqrt(12)
    assert abs(error) < 3 * std


def test_clock_map_ignores_stalled_exchanges() -> None:
    """One in ten waits for 300 ms in one direction."""
    for seed in range(20):
        rig = Rig(seed=seed, drift_ppm=100, stall_ns=300_000_000)
        clock = follow(rig, 600)

        error, std = error_ns(rig, clock)
        assert abs(error) < 3 * std < 45_000
        assert abs(estimate(clock).drift_ppm - 100) < 0.5
        assert clock.restarts == 0


@pytest.mark.parametrize("step_us", [-12_000_000, 400, -400, 30_000_000])
@pytest.mark.parametrize("stall_ns", [0, 300_000_000])
def test_clock_map_restarts_after_a_reset_of_the_device(step_us: int, stall_ns: int) -> None:
    rig = Rig(seed=5, stall_ns=stall_ns)
    clock = follow(rig, 300)
    rig.first_us += step_us

    clock = follow(rig, 14, clock)

    error, std = error_ns(rig, clock)
    assert clock.restarts == 1
    assert abs(error) < 3 * std


@pytest.mark.parametrize("drift_per_s", sampled([-0.3, 0.01, 0.1]))
@pytest.mark.parametrize("wait_us", [(20.0, 200.0), (3.0, 3.0)])
def test_clock_map_follows_a_slowly_changing_drift(
    drift_per_s: float, wait_us: tuple[float, float]
) -> None:
    offsets = drifts = 0
    for seed in range(30):
        rig = Rig(seed=seed, wait_us=wait_us, drift_per_s=drift_per_s)
        clock = follow(rig, 1200)
        error, std = error_ns(rig, clock)
        found = estimate(clock)
        drift_ppm = drift_per_s * (rig.t_ns - rig.t0_ns) / 1e9
        offsets += abs(error) < 3 * std
        drifts += abs(found.drift_ppm - drift_ppm) < 3 * found.drift_std_ppm
        assert clock.restarts == 0
        assert abs(found.drift_ppm - drift_ppm) < 0.5 + 60 * abs(drift_per_s)  # 2 tau of lag

    assert offsets >= 28
    assert drifts >= 27


def test_clock_map_adapts_to_a_longer_round_trip() -> None:
    rig = Rig(seed=11, drift_ppm=100)
    clock = follow(rig, 300)
    rig.link = LinkTiming(request_ns=680_000, answer_ns=760_000)

    clock = follow(rig, 1800, clock)

    error, std = error_ns(rig, clock)
    assert clock.floor_ns > 1_440_000
    assert abs(error) < 3 * std < 40_000


def test_the_least_and_median_round_trip_are_of_the_last_hundred_exchanges() -> None:
    clock, floors, medians = start(LINK), [], []
    for n in range(160):
        round_trip_ns = 450_000 if n == 0 else 500_000 if n <= 60 else 600_000
        h1_ns, rx_us = n * 100_000_000, n * 100_000 + 200
        clock = update(clock, h1_ns, rx_us, rx_us + 20, h1_ns + 20_000 + round_trip_ns)
        floors.append(clock.floor_ns)
        medians.append(clock.median_ns)

    assert floors == [450_000] * 100 + [500_000] * 60
    assert medians.index(600_000) == 60 + 50
    assert len(clock.round_trips) == 100
