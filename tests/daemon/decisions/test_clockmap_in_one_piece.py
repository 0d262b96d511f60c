"""The recursive map of the clocks, compared with a regression over all exchanges at once."""

from __future__ import annotations

from math import exp, sqrt
from typing import NamedTuple

import numpy as np
import pytest
from armrig_daemon.decisions import clockmap
from armrig_daemon.decisions.clockmap import ClockMap, LinkTiming

LINK = LinkTiming(request_ns=120_000, answer_ns=230_000, resolution_us=4, tau_ns=7_000_000_000)
PRIOR = 1 / 9  # a drift of 3000 ppm, in (ns/µs)⁻²
VARIANCE_OF_C = 1 / 12  # of one uniform in [-1/2, 1/2]
EPOCH_NS, EPOCH_US = 10**15, 3 * 10**9  # large: nothing may cancel


class Stamps(NamedTuple):
    """One exchange."""

    h1_ns: int
    rx_us: int
    tx_us: int
    h4_ns: int

    @property
    def r(self) -> int:
        """Round trip without the device's own time."""
        return self.h4_ns - self.h1_ns - 1000 * (self.tx_us - self.rx_us)

    @property
    def d(self) -> float:
        """Device's time at its middle, from the epoch, in µs."""
        return (self.rx_us + self.tx_us) / 2 - EPOCH_US

    @property
    def y(self) -> float:
        """Host's time then less 1000 d, from the epoch, in ns."""
        middle = (self.h1_ns + self.h4_ns - LINK.answer_ns + LINK.request_ns) / 2 - EPOCH_NS
        return middle - 1000 * self.d


def exchanges(n: int, seed: int = 1, jitter_ns: float = 40_000) -> list[Stamps]:
    """Return n honest exchanges a tenth of a second apart, with a drift of 40 ppm."""
    rng = np.random.default_rng(seed)
    found = []
    for i in range(n):
        there, back = rng.exponential(jitter_ns, 2)
        at_us = 100_000 * i + int(rng.integers(0, 1000))
        held_us = int(rng.integers(20, 200))
        h1_ns = EPOCH_NS + round(1000.04 * at_us - LINK.request_ns - there)
        h4_ns = EPOCH_NS + round(1000.04 * (at_us + held_us) + LINK.answer_ns + back)
        found.append(Stamps(h1_ns, EPOCH_US + at_us, EPOCH_US + at_us + held_us, h4_ns))
    return found


class Regression(NamedTuple):
    """The weighted regression over all exchanges, and what the newest one weighs in it."""

    floor: float
    gap: float
    v: float
    share: float
    weight: float
    d: float
    y: float
    r: float
    dd: float
    dy: float
    dr: float

    @property
    def slope(self) -> float:
        return self.dy / (self.dd + PRIOR)

    @property
    def trend(self) -> float:
        return self.dr / (self.dd + PRIOR)

    def variance(self, d: float, ahead_us: float, fading: float, lag: float) -> float:
        """Variance of y at d, so far ahead of the last exchange."""
        off = (d - self.d) ** 2
        averaged = 1 / (fading * self.weight) + off / (fading * self.dd + PRIOR)
        common = (self.r - self.floor + self.gap) ** 2 + self.trend**2 * off
        common += (1000 * LINK.resolution_us) ** 2
        grown = lag * (1 + max(0.0, ahead_us) * sqrt(self.weight / (self.dd + PRIOR))) ** 2
        return averaged + VARIANCE_OF_C * common + grown**2


def path(trips: list[int]) -> tuple[float, float]:
    """Return the floor and the gap after some round trips."""
    window = sorted(trips[-100:])
    n, floor = len(window), window[0]
    spread = window[n // 2] - floor
    if n < 8:
        return floor, max(spread, floor - LINK.request_ns - LINK.answer_ns)
    return floor, 0.84 * spread / (sqrt(n) - 0.84)


def at_once(found: list[Stamps], until_ns: int | None = None) -> Regression:
    """Return the regression, its weights faded to `until_ns`, else to the last exchange."""
    now_ns = found[-1].h1_ns if until_ns is None else until_ns
    step = (1000 * LINK.resolution_us) ** 2
    weights = []
    for i, e in enumerate(found):
        floor, gap = path([x.r for x in found[: i + 1]])
        excess = e.r - floor
        v = VARIANCE_OF_C * (step + (excess + gap) ** 2)
        w = 1 / (v * (1 + excess**2 / (gap**2 + step)))
        weights.append(w * exp(-(now_ns - e.h1_ns) / LINK.tau_ns))
    total = sum(weights)

    def mean(values: list[float]) -> float:
        return sum(w * x for w, x in zip(weights, values, strict=True)) / total

    d, y, r = [e.d for e in found], [e.y for e in found], [float(e.r) for e in found]
    d_, y_, r_ = mean(d), mean(y), mean(r)
    return Regression(
        floor=floor,
        gap=gap,
        v=v,
        share=weights[-1] / total,
        weight=total,
        d=d_,
        y=y_,
        r=r_,
        dd=total * mean([(x - d_) ** 2 for x in d]),
        dy=total * mean([(x - d_) * (z - y_) for x, z in zip(d, y, strict=True)]),
        dr=total * mean([(x - d_) * (z - r_) for x, z in zip(d, r, strict=True)]),
    )


def lag_after(found: list[Stamps]) -> float:
    """Return the mean of the newest innovations."""
    lag = 0.0
    for n in range(2, len(found) + 1):
        new = found[n - 1]
        before = at_once(found[: n - 1], new.h1_ns)
        innovation = new.y - before.y - before.slope * (new.d - before.d)
        lag += min(1.0, 4 * at_once(found[:n]).share) * (innovation - lag)
    return lag


def mapped(found: list[Stamps]) -> ClockMap:
    """Return the map that has gone through them."""
    clock = clockmap.start(LINK)
    for e in found:
        clock = clockmap.update(clock, *e)
    assert clock.restarts == 0
    return clock


NS = [1, 2, 3, 7, 8, 9, 30, 99, 100, 101, 130]


@pytest.mark.parametrize("n", NS)
def test_clock_map_equals_the_regression_over_all_exchanges(n: int) -> None:
    found = exchanges(n)
    clock, whole = mapped(found), at_once(found)
    last = found[-1]

    assert (clock.host_ns, clock.device_us) == (last.h1_ns, last.rx_us)
    assert clock.round_trips == tuple(e.r for e in found[-100:])
    assert clock.floor_ns == whole.floor
    assert clock.gap_ns == pytest.approx(whole.gap, rel=1e-9)
    for name in ("weight", "r"):
        assert getattr(clock, name) == pytest.approx(getattr(whole, name), rel=1e-6), name
    for name in ("dd", "dy", "dr"):
        assert getattr(clock, name) == pytest.approx(getattr(whole, name), rel=1e-5, abs=1e-9), name
    assert clock.d + last.rx_us - EPOCH_US == pytest.approx(whole.d, abs=1e-3)
    shift = last.h1_ns - EPOCH_NS - 1000 * (last.rx_us - EPOCH_US)
    assert clock.y + shift == pytest.approx(whole.y, abs=1e-2)
    assert clock.lag == pytest.approx(lag_after(found), rel=1e-4, abs=1e-3)


@pytest.mark.parametrize("ahead_us", [-3_000_000, 0, 1, 2_000_000, 1_000_000_000])
@pytest.mark.parametrize("n", [1, 5, 40])
def test_clock_map_predicts_like_the_regression(n: int, ahead_us: int) -> None:
    found = exchanges(n)
    clock, whole = mapped(found), at_once(found)
    device_us = found[-1].rx_us + ahead_us
    d = device_us - EPOCH_US
    fading = exp(-min(10.0, max(0.0, 1000 * ahead_us / LINK.tau_ns)))

    host = clockmap.host_ns_at(clock, device_us)
    std = clockmap.std_ns_at(clock, device_us)

    assert host - EPOCH_NS == pytest.approx(1000 * d + whole.y + whole.slope * (d - whole.d), abs=2)
    variance = whole.variance(d, ahead_us, fading, lag_after(found))
    assert std == pytest.approx(sqrt(variance), rel=1e-5)
    # From the map's own means and moments, which are those of the regression, to the last digit.
    known = {name: getattr(clock, name) for name in ("weight", "r", "dd", "dy", "dr")}
    own = whole._replace(d=clock.d, gap=clock.gap_ns, **known)
    said = own.variance(ahead_us, ahead_us, fading, clock.lag)
    assert std == pytest.approx(sqrt(said), rel=1e-12)


@pytest.mark.parametrize("n", [1, 5, 40])
def test_estimate_of_the_clock_map_equals_the_regression(n: int) -> None:
    found = exchanges(n)
    clock, whole, lag = mapped(found), at_once(found), lag_after(found)

    said = clockmap.estimate(clock)

    last = found[-1]
    assert said.offset_ns == clockmap.host_ns_at(clock, last.rx_us) - 1000 * last.rx_us
    assert said.offset_std_ns == clockmap.std_ns_at(clock, last.rx_us)
    assert said.drift_ppm == pytest.approx(1000 * whole.slope, rel=1e-5, abs=1e-6)
    variance = 1 / (whole.dd + PRIOR) + VARIANCE_OF_C * whole.trend**2
    variance += 4 * lag**2 * whole.weight / (whole.dd + PRIOR)
    assert said.drift_std_ppm == pytest.approx(1000 * sqrt(variance), rel=1e-5)
    assert said.bound_ns == (whole.floor - LINK.request_ns - LINK.answer_ns) / 2


def test_bound_of_the_offset_is_not_negative() -> None:
    clock = clockmap.update(clockmap.start(LINK), 0, 5, 5, LINK.request_ns + LINK.answer_ns - 9)

    assert clockmap.estimate(clock).bound_ns == 0


def moved(e: Stamps, by_ns: float) -> Stamps:
    """Return an exchange whose both ends the host's clock shows later."""
    return e._replace(h1_ns=e.h1_ns + round(by_ns), h4_ns=e.h4_ns + round(by_ns))


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize(("deviations", "fits"), [(4.95, True), (5.05, False)])
def test_an_exchange_fits_within_five_deviations(sign: int, deviations: float, fits: bool) -> None:
    *known, new = exchanges(40)
    clock = mapped(known)
    before = at_once(known, new.h1_ns)
    expected = before.y + before.slope * (new.d - before.d)
    floor, gap = path([e.r for e in [*known, new]])
    seen = before._replace(floor=floor, gap=gap)
    own = VARIANCE_OF_C * ((new.r - floor + gap) ** 2 + (1000 * LINK.resolution_us) ** 2)
    ahead = (new.tx_us - new.rx_us) / 2
    sigma = sqrt(own + seen.variance(new.d, ahead, 1.0, clock.lag))

    after = clockmap.update(clock, *moved(new, expected - new.y + sign * deviations * sigma))

    assert (after.rejected == 0) == fits
    assert (after.device_us == new.rx_us) == fits
    assert after.round_trips[-1] == new.r  # the way is what it is


def test_the_eighth_exchange_in_a_row_that_does_not_fit_begins_the_map_again() -> None:
    found = exchanges(48)
    clock = mapped(found[:40])
    for i, e in enumerate(found[40:], 1):
        clock = clockmap.update(clock, *moved(e, 1e9))
        if i < 8:
            assert (clock.rejected, clock.restarts) == (i, 0)

    assert (clock.rejected, clock.restarts) == (0, 1)
    assert (clock.dd, clock.dy, clock.dr, clock.lag) == (0, 0, 0, 0)
    assert len(clock.round_trips) == 48
    host_ns = clockmap.host_ns_at(clock, found[-1].rx_us)
    assert host_ns == pytest.approx(found[-1].h1_ns + 1e9 + LINK.request_ns, abs=200_000)


@pytest.mark.parametrize("slow", [False, True])
def test_the_count_of_misfits_restarts_after_an_exchange_of_the_faster_half(slow: bool) -> None:
    *known, new = exchanges(41)
    clock = mapped(known)._replace(rejected=3)
    stalled = new._replace(h4_ns=new.h4_ns + 3_000_000, h1_ns=new.h1_ns - 3_000_000)

    after = clockmap.update(clock, *(stalled if slow else new))

    quick = new.r <= sorted(e.r for e in [*known, new])[41 // 2]
    assert quick
    assert after.rejected == (3 if slow else 0)
    assert after.device_us == new.rx_us


@pytest.mark.parametrize(
    ("backwards_ns", "held_us", "counts"),
    [(8_000, 0, True), (8_001, 0, False), (0, -1, False), (0, 0, True)],
)
def test_clock_map_rejects_impossible_stamps(backwards_ns: int, held_us: int, counts: bool) -> None:
    h1_ns, rx_us = EPOCH_NS, EPOCH_US
    h4_ns = h1_ns + 1000 * held_us - backwards_ns

    after = clockmap.update(clockmap.start(LINK), h1_ns, rx_us, rx_us + held_us, h4_ns)

    assert (after.weight > 0) == counts
    assert after.rejected == (not counts)


@pytest.mark.parametrize("ask", [clockmap.host_ns_at, clockmap.std_ns_at])
def test_clock_map_without_an_exchange_raises(ask: object) -> None:
    with pytest.raises(ValueError, match="knows no exchange"):
        ask(clockmap.start(LINK), 5)


@pytest.mark.parametrize(
    ("last", "raw", "is_"),
    [
        (0, 5, 5),
        (5, 5, 5),
        ((1 << 32) + 10, 20, (1 << 32) + 20),
        ((1 << 32) - 1, 0, 1 << 32),
        ((1 << 32) + 10, (1 << 32) - 1, (1 << 32) - 1),
        ((1 << 32) + (1 << 24), 0, 1 << 32),
        ((1 << 32) + (1 << 24) + 1, 0, 1 << 33),
    ],
)
def test_a_clock_that_wraps_is_read_next_to_its_last_reading(last: int, raw: int, is_: int) -> None:
    """Up to 2^24 µs before it, less than the rest of a wrap after it."""
    assert clockmap.extend(last, raw) == is_
