"""The map from the device's clock to the host's, from exchanges of PING and PONG.

An exchange has four stamps: PING leaves the host at `h1_ns` and has come to the device at
`rx_us`; PONG begins to leave it at `tx_us` and has come to the host at `h4_ns`. With the times
on the wire known, the host's time at the middle of `rx_us` and `tx_us` is the middle of `h1_ns`
and `h4_ns`, but for (qf - qb)/2, where qf and qb >= 0 are what the request and the answer waited
besides. Only their sum is seen, e = qf + qb, so that the error is c · e with c in [-1/2, 1/2].

A waiting time has one sign: its mean does not average out. So c counts as unknown and common
to all exchanges, with the variance 1/12 of a uniform one, and short round trips lead.

What no exchange shows is the part of qf - qb that is always there: half of it, at most
`Estimate.bound_ns`, is in the offset and not in its standard deviation. It does not touch
the drift.

Raw times stay: the map is asked, never applied in place.

References
----------
.. [1] D. L. Mills, *Computer Network Time Synchronization*, 2nd ed., 2010, chapters 2 and 3:
   four stamps, the wedge of offset against round trip, the least round trip of a window.
.. [2] L. Ljung, *System Identification*, 2nd ed., 1999, section 11.2: exponential forgetting.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from armrig_core.errors import InputError

_WRAP = 1 << 32
_BACK_US = 1 << 24  # 16.8 s; leaves 71.3 min of silence before a wrap is missed
_DRIFT_PRIOR = 1 / 3.0**2  # (ns/µs)⁻²: 3000 ppm, a ceramic resonator is good to 0.5 %
_C_VARIANCE = 1 / 12  # of c, uniform in [-1/2, 1/2]
_WINDOW = 100  # round trips among which the least is looked for
_FEW = 8  # round trips of which no quantile says anything
_GATE = 5.0**2  # the error of an honest exchange is within √3 of its part of the deviation
_MOST_REJECTED = 8
_BRISK = 4.0  # the lag is a mean over a quarter of what the regression remembers
_MOST_FADING = 10.0  # time constants; more would only overflow


class Link(NamedTuple):
    """What is known beforehand of the way to the device."""

    request_ns: int = 0
    """Time of PING on the wire."""
    answer_ns: int = 0
    """Time of PONG on the wire."""
    resolution_us: int = 1
    """Step of the device's clock."""
    tau_ns: int = 30_000_000_000
    """Time constant of the forgetting."""


class ClockMap(NamedTuple):
    """What the exchanges so far say of the device's clock.

    A weighted regression of y = host - 1000 · device (ns) on d = device (µs), and of the round
    trip r on d, by weighted means and centred moments; y and d count from the last exchange, in
    integers, so that nothing cancels however long it runs.
    """

    link: Link = Link()
    host_ns: int = 0
    """Host's time from which y counts: h1 of the last exchange."""
    device_us: int = 0
    """Device's time from which y and d count: rx of the last exchange."""
    weight: float = 0.0
    """Sum of 1/variance, faded, in ns⁻²; 0 where nothing is known."""
    d: float = 0.0
    """Mean of d, in µs."""
    y: float = 0.0
    """Mean of y, in ns."""
    r: float = 0.0
    """Mean of r, in ns."""
    dd: float = 0.0
    """Centred moment of d with d, weighted, as the next two."""
    dy: float = 0.0
    dr: float = 0.0
    lag: float = 0.0
    """Mean of the newest innovations, in ns: 0 but for noise while the drift is constant."""
    round_trips: tuple[int, ...] = ()
    """The newest, in ns, at most `_WINDOW`."""
    floor_ns: int = 0
    """The least of them."""
    median_ns: int = 0
    """The median of them."""
    gap_ns: float = 0.0
    """How far the shortest round trip possible may lie below the least one seen."""
    rejected: int = 0
    """Exchanges in a row that did not fit."""
    restarts: int = 0
    """How often the map began anew because they did not."""


class Estimate(NamedTuple):
    """The two clocks against each other, at the last exchange."""

    offset_ns: int
    """Host's time less 1000 times the device's."""
    offset_std_ns: float
    drift_ppm: float
    """What the offset gains; positive where the device's clock is slow."""
    drift_std_ppm: float
    bound_ns: float
    """Half of the least round trip beyond the wire: the most that a constant asymmetry hides."""


def start(link: Link) -> ClockMap:
    """Return a map that knows nothing yet but the link."""
    return ClockMap(link)


def extend(last_us: int, raw_us: int) -> int:
    """Return the device's time, wraps undone, that is next to `last_us` and reads `raw_us`.

    It is at most 16.8 s before `last_us` (messages overtake each other), or less than 71.3 min
    after it; a longer silence loses a wrap. The first reading extends itself.
    """
    return last_us - _BACK_US + ((raw_us - last_us + _BACK_US) % _WRAP)


def update(clock: ClockMap, h1_ns: int, rx_us: int, tx_us: int, h4_ns: int) -> ClockMap:
    """Return the map that knows of one exchange more.

    Parameters
    ----------
    clock : ClockMap
    h1_ns, h4_ns : int
        When PING was sent and PONG had come, by the host's monotonic clock.
    rx_us, tx_us : int
        When PING had come and PONG began to leave, by the device's clock, extended.

    Notes
    -----
    v is the variance of an exchange's error where c is random. It counts with less than 1/v, the
    less the longer its round trip: long ones have an error whose mean does not average out.
    Where the innovation is beyond five times its standard deviation the exchange is left out;
    after eight in a row the map begins anew, with the last of them.
    """
    link = clock.link
    r = h4_ns - h1_ns - 1000 * (tx_us - rx_us)
    if r < -2000 * link.resolution_us or tx_us < rx_us:
        return _reject(clock)  # the device's clock jumped between its two stamps
    clock = _window(clock, r)
    excess = r - clock.floor_ns
    step = (1000.0 * link.resolution_us) ** 2
    near = clock.gap_ns * clock.gap_ns + step
    v = _C_VARIANCE * (step + (excess + clock.gap_ns) ** 2)
    w = 1 / (v * (1 + excess * excess / near))
    d = 0.5 * (tx_us - rx_us)
    y = 0.5 * (h4_ns - h1_ns - link.answer_ns + link.request_ns) - 1000 * d
    moved = _moved(clock, h1_ns, rx_us)
    if clock.weight == 0:
        return _add(_blank(moved), d, y, r, w, 0.0)
    innovation = y - moved.y - _slope(moved) * (d - moved.d)
    variance = v + _variance(moved, d, 1.0)
    if innovation * innovation > _GATE * variance:
        if clock.rejected + 1 < _MOST_REJECTED:
            return _reject(clock)
        anew = _blank(moved)._replace(restarts=clock.restarts + 1)
        return _add(anew, d, y, r, w, 0.0)
    # A stalled exchange agrees with anything: only one of the better half ends a row.
    rejected = 0 if r <= clock.median_ns else clock.rejected
    return _add(moved._replace(rejected=rejected), d, y, r, w, innovation)


def host_ns_at(clock: ClockMap, device_us: int) -> int:
    """Return the host's time at a time of the device, in ns.

    Raises
    ------
    ValueError
        The map has seen no exchange.
    """
    _require_exchange(clock)
    past_us = device_us - clock.device_us
    y = clock.y + _slope(clock) * (past_us - clock.d)
    return clock.host_ns + 1000 * past_us + round(y)


def std_ns_at(clock: ClockMap, device_us: int) -> float:
    """Return the standard deviation of `host_ns_at`, in ns.

    Beyond the last exchange what is known fades with the time constant of the regression, and
    the standard deviation grows. It holds at least the device's resolution, which repeats from
    reading to reading and does not average out.

    Raises
    ------
    ValueError
        The map has seen no exchange.
    """
    _require_exchange(clock)
    past_us = device_us - clock.device_us
    return math.sqrt(_variance(clock, past_us, _fading(clock.link, 1000 * past_us)))


def _require_exchange(clock: ClockMap) -> None:
    if clock.weight == 0:
        raise InputError("the map knows no exchange yet; PING the device first")


def estimate(clock: ClockMap) -> Estimate:
    """Return offset and drift at the last exchange, with their standard deviations.

    Raises
    ------
    ValueError
        The map has seen no exchange.
    """
    host_ns = host_ns_at(clock, clock.device_us)
    std_ns = std_ns_at(clock, clock.device_us)
    link = clock.link
    variance = 1 / (clock.dd + _DRIFT_PRIOR) + _C_VARIANCE * _trend(clock) ** 2
    # Where the drift changes at a rate a, y lags by a s² and the drift by 2 a s, s² the variance
    # of d (exponential memory; within 15 % for a short, even one).
    variance += 4 * clock.lag**2 * clock.weight / (clock.dd + _DRIFT_PRIOR)
    return Estimate(
        host_ns - 1000 * clock.device_us,
        std_ns,
        1000 * _slope(clock),
        1000 * math.sqrt(variance),
        max(0, clock.floor_ns - link.request_ns - link.answer_ns) / 2,
    )


def _slope(clock: ClockMap) -> float:
    """Return the drift in ns/µs."""
    return clock.dy / (clock.dd + _DRIFT_PRIOR)


def _trend(clock: ClockMap) -> float:
    """Return how the round trip grows, in ns/µs: so much times c is taken for drift."""
    return clock.dr / (clock.dd + _DRIFT_PRIOR)


def _variance(clock: ClockMap, d: float, fading: float) -> float:
    """Return the variance of the regression's y at d, in ns², where the weights have faded."""
    from_mean = (d - clock.d) ** 2
    averaged = 1 / (fading * clock.weight) + from_mean / (fading * clock.dd + _DRIFT_PRIOR)
    excess = clock.r - clock.floor_ns + clock.gap_ns
    common = excess * excess + _trend(clock) ** 2 * from_mean
    step = (1000.0 * clock.link.resolution_us) ** 2
    # A drift that goes on changing as it did: (1 + x)² is at least 1 + 2 x + x²/2.
    ahead = 1 + max(0.0, d) * math.sqrt(clock.weight / (clock.dd + _DRIFT_PRIOR))
    return averaged + _C_VARIANCE * (common + step) + (clock.lag * ahead * ahead) ** 2


def _fading(link: Link, past_ns: int) -> float:
    """Return the share of its weight that an exchange keeps over a time."""
    return math.exp(-min(max(0.0, past_ns / link.tau_ns), _MOST_FADING))


def _window(clock: ClockMap, r: int) -> ClockMap:
    """Take note of a round trip, and of how near the least of the window is to the least of all.

    Two exponential waiting times with means m and m' fall both below x with a chance of
    x²/(2 m m'), so that the least of N has the root mean square √(2 m m'/N): at most
    0.84/√N times the median, which stalls do not touch.
    """
    link = clock.link
    round_trips = (*clock.round_trips[1 - _WINDOW :], r)
    floor_ns = min(round_trips)
    n = len(round_trips)
    median_ns = sorted(round_trips)[n // 2]
    spread = median_ns - floor_ns
    if n < _FEW:
        gap_ns = float(max(spread, floor_ns - link.request_ns - link.answer_ns))
    else:
        gap_ns = 0.84 * spread / (math.sqrt(n) - 0.84)
    return clock._replace(
        round_trips=round_trips, floor_ns=floor_ns, median_ns=median_ns, gap_ns=gap_ns
    )


def _moved(clock: ClockMap, host_ns: int, device_us: int) -> ClockMap:
    """Count from another instant, and fade what is known up to it."""
    d_us, h_ns = device_us - clock.device_us, host_ns - clock.host_ns
    fading = _fading(clock.link, h_ns)
    return clock._replace(
        host_ns=host_ns,
        device_us=device_us,
        weight=fading * clock.weight,
        d=clock.d - d_us,
        y=clock.y - (h_ns - 1000 * d_us),
        dd=fading * clock.dd,
        dy=fading * clock.dy,
        dr=fading * clock.dr,
    )


def _add(clock: ClockMap, d: float, y: float, r: int, w: float, error: float) -> ClockMap:
    """Put an exchange of weight w, which came as a surprise of `error`, into the regression."""
    weight = clock.weight + w
    share = w / weight
    d_off, y_off, r_off = d - clock.d, y - clock.y, r - clock.r
    moment = clock.weight * share * d_off
    return clock._replace(
        weight=weight,
        d=clock.d + share * d_off,
        y=clock.y + share * y_off,
        r=clock.r + share * r_off,
        dd=clock.dd + moment * d_off,
        dy=clock.dy + moment * y_off,
        dr=clock.dr + moment * r_off,
        lag=clock.lag + min(1.0, _BRISK * share) * (error - clock.lag),
    )


def _reject(clock: ClockMap) -> ClockMap:
    return clock._replace(rejected=clock.rejected + 1)


def _blank(clock: ClockMap) -> ClockMap:
    """Forget the clocks; the way between them is what it was."""
    return clock._replace(
        weight=0.0, d=0.0, y=0.0, r=0.0, dd=0.0, dy=0.0, dr=0.0, lag=0.0, rejected=0
    )
