"""Map from the device's clock to the host's, estimated from exchanges of PING and PONG.

An exchange has four time stamps. PING leaves the host at `h1_ns` and has arrived at the device at
`rx_us`. PONG begins to leave the device at `tx_us` and has arrived at the host at `h4_ns`. The
transmission times are known and subtracted. Then the middle of `h1_ns` and `h4_ns` is the host's
time at the middle of `rx_us` and `tx_us`, with an error of (qf - qb)/2. Here qf and qb >= 0 are the
waiting times of the request and of the answer. Only their sum e = qf + qb is observed, so the error
is c · e with c in [-1/2, 1/2].

A waiting time is never negative, so its mean is not 0 and does not average out. Therefore c is
treated as unknown but equal in all exchanges, with the variance 1/12 of a uniform distribution.
Short round trips get the largest weights.

No exchange shows the constant part of qf - qb. Half of this part, at most `ClockFit.bound_ns`, is
an error of the offset, which the standard deviation of the offset does not include. The drift is
not affected.

The device's raw times are stored unchanged. They are converted to the host's time only where that
time is needed.

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
_DRIFT_PRIOR = 1 / 3.0**2  # (ns/µs)⁻²: 3000 ppm; a ceramic resonator is within 0.5 %
_C_VARIANCE = 1 / 12  # of c, uniform in [-1/2, 1/2]
_WINDOW_SIZE = 100  # newest round trips, whose minimum is taken
_MIN_QUANTILE_SIZE = 8  # with fewer round trips a quantile is meaningless
_GATE_VARIANCES = 5.0**2  # |c| <= 1/2 keeps an error within √3 standard deviations
_MAX_REJECTED = 8
_LAG_GAIN = 4.0  # the lag is a mean over a quarter of the regression's memory
_MAX_FADING = 10.0  # time constants; with more, 1/weight would overflow


class LinkTiming(NamedTuple):
    """Known properties of the line to the device."""

    request_ns: int = 0
    """Transmission time of PING, in ns."""
    answer_ns: int = 0
    """Transmission time of PONG, in ns."""
    resolution_us: int = 1
    """Resolution of the device's clock, in µs."""
    tau_ns: int = 30_000_000_000
    """Time constant with which the weights of old exchanges fade."""


class ClockMap(NamedTuple):
    """Map between the two clocks, estimated from the exchanges so far.

    The estimate is a weighted regression of y = host - 1000 · device (ns) on d = device (µs), and
    of the round trip r on d. It is stored as weighted means and centred moments. The origins of y
    and d are times of the last exchange, stored as integers, so that no digits are lost by
    cancellation in a long run.
    """

    link: LinkTiming = LinkTiming()
    host_ns: int = 0
    """Origin of the host's time in y, in ns: h1 of the last exchange."""
    device_us: int = 0
    """Origin of the device's time in y and in d, in µs: rx of the last exchange."""
    weight: float = 0.0
    """Sum of the faded weights of the exchanges, in ns⁻²; 0 before the first exchange."""
    d: float = 0.0
    """Mean of d, in µs."""
    y: float = 0.0
    """Mean of y, in ns."""
    r: float = 0.0
    """Mean of r, in ns."""
    dd: float = 0.0
    """Weighted centred moment of d with d; `dy` and `dr` are the moments of d with y and with r."""
    dy: float = 0.0
    dr: float = 0.0
    lag: float = 0.0
    """Mean of the newest innovations, in ns; 0 apart from noise if the drift is constant."""
    round_trips: tuple[int, ...] = ()
    """Newest round trips, in ns, at most `_WINDOW_SIZE`."""
    floor_ns: int = 0
    """Minimum of `round_trips`."""
    median_ns: int = 0
    """Median of `round_trips`."""
    gap_ns: float = 0.0
    """Estimated excess of `floor_ns` over the shortest possible round trip, in ns."""
    rejected: int = 0
    """Number of consecutive exchanges that the map rejected."""
    restarts: int = 0
    """Number of restarts of the map after too many rejected exchanges."""


class ClockFit(NamedTuple):
    """Offset and drift between the two clocks, at the last exchange."""

    offset_ns: int
    """Host's time in ns minus 1000 times the device's time in µs."""
    offset_std_ns: float
    drift_ppm: float
    """Growth of the offset; positive if the device's clock is slow."""
    drift_std_ppm: float
    bound_ns: float
    """Largest error of the offset, in ns, that a constant qf - qb can cause.

    The bound is half the waiting time in the shortest round trip.
    """


def start(link: LinkTiming) -> ClockMap:
    """Return the map before the first exchange."""
    return ClockMap(link)


def extend(last_us: int, raw_us: int) -> int:
    """Return the reading `raw_us` of the device's 32-bit clock, extended to a time without wraps.

    `last_us` is the extended time of an earlier reading. The result is at most 16.8 s before
    `last_us` (messages may overtake each other), or less than 71.3 min after `last_us`. After a
    longer silence, a wrap is lost. The extended time of the first reading is the reading itself.
    """
    return last_us - _BACK_US + ((raw_us - last_us + _BACK_US) % _WRAP)


def update(clock: ClockMap, h1_ns: int, rx_us: int, tx_us: int, h4_ns: int) -> ClockMap:
    """Return the map with one more exchange.

    Parameters
    ----------
    clock : ClockMap
    h1_ns, h4_ns : int
        Times at which PING was sent and PONG had arrived, by the host's monotonic clock.
    rx_us, tx_us : int
        Times at which PING had arrived and PONG began to leave, by the device's clock, without
        wraps.

    Notes
    -----
    v is the variance of an exchange's error for a random c. A long round trip gets a weight below
    1/v, because the mean error of long round trips does not average out. If the innovation exceeds
    five times its standard deviation, the exchange is rejected. After eight rejections in a row the
    map restarts with the last exchange.
    """
    link = clock.link
    r = h4_ns - h1_ns - 1000 * (tx_us - rx_us)
    if r < -2000 * link.resolution_us or tx_us < rx_us:
        return _reject(clock)  # the device's clock jumped between its two time stamps
    clock = _window(clock, r)
    excess = r - clock.floor_ns
    step = (1000.0 * link.resolution_us) ** 2
    near = clock.gap_ns * clock.gap_ns + step
    v = _C_VARIANCE * (step + (excess + clock.gap_ns) ** 2)
    w = 1 / (v * (1 + excess * excess / near))
    d = 0.5 * (tx_us - rx_us)
    y = 0.5 * (h4_ns - h1_ns - link.answer_ns + link.request_ns) - 1000 * d
    moved = _move_origin(clock, h1_ns, rx_us)
    if clock.weight == 0:
        return _add(_blank(moved), d, y, r, w, 0.0)
    innovation = y - moved.y - _slope(moved) * (d - moved.d)
    variance = v + _variance(moved, d, 1.0)
    if innovation * innovation > _GATE_VARIANCES * variance:
        if clock.rejected + 1 < _MAX_REJECTED:
            return _reject(clock)
        restarted = _blank(moved)._replace(restarts=clock.restarts + 1)
        return _add(restarted, d, y, r, w, 0.0)
    # A very slow exchange fits any map. Only an exchange whose round trip is not above the median
    # resets the number of rejections.
    rejected = 0 if r <= clock.median_ns else clock.rejected
    return _add(moved._replace(rejected=rejected), d, y, r, w, innovation)


def host_ns_at(clock: ClockMap, device_us: int) -> int:
    """Return the host's time, in ns, that corresponds to a time of the device.

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

    After the last exchange the weights fade with the time constant of the regression, and the
    standard deviation grows. The result is at least the standard deviation of the rounding to the
    device's resolution. The rounding error repeats from reading to reading and does not average
    out.

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


def estimate(clock: ClockMap) -> ClockFit:
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
    # If the drift changes at a rate a, y lags by a s² and the drift by 2 a s. s² is the variance
    # of d (exponential memory; within 15 % for a short, uniform memory).
    variance += 4 * clock.lag**2 * clock.weight / (clock.dd + _DRIFT_PRIOR)
    return ClockFit(
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
    """Return the growth of the round trip, in ns/µs; c times this is an error of the drift."""
    return clock.dr / (clock.dd + _DRIFT_PRIOR)


def _variance(clock: ClockMap, d: float, fading: float) -> float:
    """Return the variance of the regression's y at d, in ns², with weights faded by `fading`."""
    from_mean = (d - clock.d) ** 2
    averaged = 1 / (fading * clock.weight) + from_mean / (fading * clock.dd + _DRIFT_PRIOR)
    excess = clock.r - clock.floor_ns + clock.gap_ns
    common = excess * excess + _trend(clock) ** 2 * from_mean
    step = (1000.0 * clock.link.resolution_us) ** 2
    # If the drift changes at a constant rate, y lags by lag · (1 + 2 x + x²/2) with
    # x = ahead - 1, which is at most lag · (1 + x)².
    ahead = 1 + max(0.0, d) * math.sqrt(clock.weight / (clock.dd + _DRIFT_PRIOR))
    return averaged + _C_VARIANCE * (common + step) + (clock.lag * ahead * ahead) ** 2


def _fading(link: LinkTiming, past_ns: int) -> float:
    """Return the share of an exchange's original weight that is left after `past_ns`."""
    return math.exp(-min(max(0.0, past_ns / link.tau_ns), _MAX_FADING))


def _window(clock: ClockMap, r: int) -> ClockMap:
    """Add a round trip, and estimate `gap_ns`."""
    # The sum of two exponential waiting times with means m and m' is below x with a probability of
    # x²/(2 m m'). `gap_ns`, the excess of the window's minimum over the shortest possible round
    # trip, is the smallest of N such sums, with the root mean square √(2 m m'/N): at most 0.84/√N
    # times the median. Stalls do not change the median.
    link = clock.link
    round_trips = (*clock.round_trips[1 - _WINDOW_SIZE :], r)
    floor_ns = min(round_trips)
    n = len(round_trips)
    median_ns = sorted(round_trips)[n // 2]
    spread = median_ns - floor_ns
    if n < _MIN_QUANTILE_SIZE:
        gap_ns = float(max(spread, floor_ns - link.request_ns - link.answer_ns))
    else:
        gap_ns = 0.84 * spread / (math.sqrt(n) - 0.84)
    return clock._replace(
        round_trips=round_trips, floor_ns=floor_ns, median_ns=median_ns, gap_ns=gap_ns
    )


def _move_origin(clock: ClockMap, host_ns: int, device_us: int) -> ClockMap:
    """Move the origin of y and d to another instant, and fade the weights up to this instant."""
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
    """Add an exchange of weight w and innovation `error` to the regression."""
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
        lag=clock.lag + min(1.0, _LAG_GAIN * share) * (error - clock.lag),
    )


def _reject(clock: ClockMap) -> ClockMap:
    return clock._replace(rejected=clock.rejected + 1)


def _blank(clock: ClockMap) -> ClockMap:
    """Delete the regression, but keep the round trips, because the serial line is the same."""
    return clock._replace(
        weight=0.0, d=0.0, y=0.0, r=0.0, dd=0.0, dy=0.0, dr=0.0, lag=0.0, rejected=0
    )
