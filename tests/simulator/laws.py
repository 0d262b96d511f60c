"""Drawn control laws with their references: stable, unstable and overflowing ones."""

from __future__ import annotations

from random import Random
from struct import pack

from armrig_core.control.evaluation import Program
from armrig_core.control.monitor import MonitorProgram
from armrig_core.control.sums import Row
from armrig_protocol.messages import CODE_FULL_SCALE
from msgspec.structs import replace

from tests.simulator.options import Options
from tests.simulator.outputs import NAMES

_GROWTH = {"stable": (0.2, 0.95), "unstable": (1.01, 1.3), "overflowing": (1e2, 1e40)}
"""Least and most growth of a state in one sample."""
_ARM_SCALES = (1.0, 0.1)
"""Size of the arm's outputs, in rad."""
_ARM_NAMES = ("theta_1", "alpha")
_MONITORED = 0.7
"""Share of the laws with a monitor."""


def draw_law(rng: Random, options: Options) -> tuple[Program, bytes]:
    """Return a law within the limits of a schedule's rig, and its reference."""
    n = rng.choice([0, 1, 2, 3, 5, 8])
    channels = rng.choice([(0,)] if len(options.outputs) == 1 else [(0,), (1,), (0, 1), (1, 0)])
    turning = tuple(rng.random() < (0.2 if c else 0.7) for c in channels)
    scales, y0 = zip(*(_scale(rng, options, c) for c in channels), strict=True)
    A = _states(rng, n, rng.choices(list(_GROWTH), [6, 2, 1])[0])
    gains = (0.5, 0.2, *(0.4 / scale for scale in scales))
    rest, low = options.rest, rng.choice([options.u_min, rng.randint(options.u_min, options.rest)])
    high = rng.choice([options.u_max, rng.randint(rest, options.u_max)])
    if low == high:
        low, high = options.u_min, options.u_max
    law = Program(
        law_sha256=f"{rng.getrandbits(256):064x}",
        Ts_us=options.ts_us,
        rows=tuple((*row, *(g * rng.uniform(-1, 1) for g in gains)) for row in A),
        v_row=(*(rng.uniform(-2, 2) for _ in range(n)), rng.uniform(-1, 1)),
        u0=rng.uniform(low, high) * 5 / CODE_FULL_SCALE,
        x0=_row(rng, n),
        predictions=tuple(tuple(s * f for f in _row(rng, n)) for s in scales)
        if any(turning) or rng.random() < 0.6
        else None,
        channels=channels,
        y0=tuple(0.0 if turns else y for turns, y in zip(turning, y0, strict=True)),
        turning=turning,
        lo_code=low,
        hi_code=high,
        slew=rng.choice([0, 0, rng.randint(200, 20_000)]),
        input_delay=rng.choice([0, 0, 1, 2, 5, 40, 200]),
        most_blind=rng.choice([1, 3, 20, 20, 100]),
        most_limited=rng.choice([0, 0, 0, 3, 100]),
        tracked=(*_row(rng, n + len(channels)), 0.1) if rng.random() < 0.3 else None,
        most_error=rng.uniform(0.5, 5.0),
        most_astray=rng.choice([1, 5, 50]),
    )
    # Of a generator of its own: the law and its reference are the same with and without a monitor.
    of_monitor = Random(law.law_sha256)
    if of_monitor.random() < _MONITORED:
        predictions = law.predictions if of_monitor.random() < 0.7 else None
        monitor = _monitor(of_monitor, law, scales, bool(options.outputs))
        law = replace(law, monitor=monitor, predictions=predictions)
    reference: list[float] = []
    for _ in range(rng.randint(1, rng.choice([3, 30]))):
        reference += [rng.uniform(-1, 1)] * rng.randint(1, 40)
    return law, pack(f"<{len(reference)}d", *reference)


def _monitor(
    rng: Random, law: Program, scales: tuple[float, ...], is_described: bool
) -> MonitorProgram:
    """Return a monitor, whose model follows its outputs or is unlike the rig."""
    ny, follows = len(scales), rng.random() < 0.6
    names = NAMES if is_described else _ARM_NAMES
    m = ny if follows else rng.choice([1, 2, 3, 10])
    A = _states(rng, m, rng.choices(list(_GROWTH), [12, 2, 1])[0])
    L = [tuple(rng.uniform(-0.2, 0.2) / scale for scale in scales) for _ in range(m)]
    C = [tuple(scale * c for c in _row(rng, m)) for scale in scales]
    if follows:  # the prediction is almost the newest value, and the simulation goes to 0
        decay = rng.uniform(0.9, 1.0)
        A = [tuple(decay * (i == j) for j in range(m)) for i in range(m)]
        L = [tuple(decay * (i == j) / scale for j, scale in enumerate(scales)) for i in range(m)]
        C = [tuple(scale * (i == j) for j in range(m)) for i, scale in enumerate(scales)]
    gain = rng.choice([0.0, 0.01, 0.2])
    return MonitorProgram(
        outputs=tuple(names[channel] for channel in law.channels),
        rows=tuple(
            (*row, rng.uniform(-gain, gain), *gains) for row, gains in zip(A, L, strict=True)
        ),
        predictions=tuple(C),
        x0=(0.0,) * m if follows else _row(rng, m),
        u0=rng.uniform(0.0, 5.0),
        deviations=tuple(scale * 10.0 ** rng.uniform(-3.0, 2.0) for scale in scales),
        settling=tuple(rng.random() < 0.6 for _ in scales),
        input_delay=rng.choice([0, 0, law.input_delay, 1, 3, 200]),
        prelude=rng.choice([0, rng.randint(1, 10), rng.randint(1, 50)]),
        forward=(rng.uniform(-1.0, 1.0), rng.uniform(0.0, 5.0)),
        most_blind=law.most_blind,
        most_turned=tuple(rng.choice([0.05, 0.4, 3.0]) if t else None for t in law.turning),
    )


def _row(rng: Random, n: int) -> Row:
    return tuple(rng.uniform(-1, 1) for _ in range(n))


def _states(rng: Random, n: int, kind: str) -> list[Row]:
    """Return A of n states; the first state of an unstable law grows by itself."""
    growth = rng.uniform(*_GROWTH[kind])
    if kind == "stable":
        return [tuple(growth * a / n for a in _row(rng, n)) for _ in range(n)]
    return [tuple(growth * (i == j) * (i == 0) for j in range(n)) for i in range(n)]


def _scale(rng: Random, options: Options, channel: int) -> tuple[float, float]:
    """Return the size of an output, and a value near the middle of its range."""
    if not options.outputs:
        return _ARM_SCALES[channel], rng.uniform(-0.2, 0.2)
    output = options.outputs[channel]
    return 10_000 * abs(output.per_count), (32_768 - output.zero) * output.per_count
