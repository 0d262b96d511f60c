"""Drawn options of a seed: the rig, its commanders, and its faults."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from random import Random
from typing import Final, NamedTuple

from armrig_daemon.emulator.layout import LAYOUTS

from tests.simulator.outputs import Output, draw_outputs

MS: Final = 1_000_000
_FIRST_NS: Final = 250 * MS
CLEAR_NS: Final = 3_400 * MS
"""From here on there is no fault: the rig has to recover by itself (T1)."""
END_NS: Final = CLEAR_NS + 700 * MS
"""Time at which sampling must be back, in ns: boards that boot in 50 ms have a third of T1.

It is short, so that faults meet each other.
"""

WAYS: Final = ("to_device", "from_device")
LINE: Final = ("loss", "duplicate", "delay", "reorder", "flip", "replay", "garbage", "split")
ELSEWHERE: Final = (
    "pause",
    "pause_in_write",
    "late",
    "kill",
    "played_again",
    "old_frames",
    "service_gone",
    "reset",
    "unplug",
    "stuck",
    "rail",
    "hang",
    "intruder",
    "forgery",
    "out_of_range",
    "slow_service",
    "full_pipe",
)
KINDS: Final = (*(f"{kind} {way}" for way in WAYS for kind in LINE), *ELSEWHERE)
"""Every fault, with each direction of the line by itself."""


_WEIGHTS: Final = {
    "full_pipe": 0.5,  # the pipe's real reader costs time
    # Each strikes once in its episode, or not at all where the process is gone.
    "service_gone": 2.5,
    "old_frames": 2.0,
    "pause": 1.6,
    "kill": 1.7,
    "played_again": 1.4,
    "unplug": 1.4,
    "hang": 1.4,
    "reset": 1.2,
    "pause_in_write": 1.2,
    "slow_service": 2.0,
    "stuck": 1.4,
    # Fewer frames go there than come back.
    "replay to_device": 1.4,
    "flip to_device": 1.4,
}
"""Relative frequencies of the faults."""


_TS_US: Final = {2_000: 2, 5_000: 50, 10_000: 25, 20_000: 23}
"""Frequencies of the sampling times, in a hundred: a short time costs as many more ticks."""


_LAWS: Final = 0.4
"""Share of the schedules with control runs, if the limits of the rig permit a law."""
_LAW_TS_US: Final = (5_000, 10_000, 10_000, 20_000)
"""Sampling times of these schedules: a law costs a tick more, and has at least 5 ms."""


_UNO: Final = {"boot_ms": 58.0, "queue": 256, "clock_ppm": 0.0, "clock_start_us": 0}
"""Properties of an Uno; its boot takes this time up to its report."""


class Episode(NamedTuple):
    """One fault and its time."""

    kind: str
    t_ns: int
    for_ns: int
    size: float
    """From 0 to 1: how likely, how much, or which of two."""

    @property
    def end_ns(self) -> int:
        """End of the episode."""
        return self.t_ns + self.for_ns


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """One schedule; all of it follows from the seed."""

    seed: int
    ts_us: int
    watchdog_ms: int
    u_min: int
    u_max: int
    slew: int
    turns: int
    rail_ticks: int
    stop_after: int
    service_ns: int
    boot_ms: float
    pwm_bits: int
    queue: int
    """Setpoints that the device holds: the most there is, or what an Uno has room for."""
    adc_noise_v: float
    clock_ppm: float
    clock_start_us: int
    """Time of the device's clock at its reset: some begin shortly before the wrap."""
    usb_ns: int
    """Delay of the answers by a USB bridge, in ns."""
    client_ns: int
    """Period of the commander's actions, in ns."""
    modes: tuple[str, ...]
    """Modes of the commander, one grant after the other."""
    goes_on: bool
    """The commander goes on after the faults; otherwise it is silent."""
    real_outbox: bool
    """The pipe to the service is the real one; otherwise only its reader's part."""
    episodes: tuple[Episode, ...]
    rest: int = 0
    """Code at which the actuator does nothing."""
    outputs: tuple[Output, ...] = ()
    """Described outputs and their limits; without any, the rig is the arm."""
    stalls: tuple[Episode, ...] = ()
    """Stalls of the emulating process; from a size of 0.5 on of the whole machine."""
    tolerates_stalls: bool = False
    """The device's clock stops meanwhile."""
    c_core: bool = False
    """The device's firmware is the C core, not the Python one; nothing else changes."""
    uno: str = ""
    """The device is an Uno in simavr with this image; its converter, PWM and clock are its own."""

    def lines(self) -> list[str]:
        """Return all of it, one option a line."""
        plain = [f for f in fields(self) if f.name not in ("episodes", "stalls")]
        shown = [f"{f.name} = {getattr(self, f.name)!r}" for f in plain]
        for e in (*self.episodes, *self.stalls):
            times = f"{e.t_ns / MS:8.1f} ms for {e.for_ns / MS:6.1f} ms"
            shown.append(f"fault {e.kind:22} from {times}, size {e.size:.3f}")
        return shown


def draw(
    seed: int,
    *,
    only: Sequence[str] = KINDS,
    stalls: bool | None = None,
    c_core: bool = False,
    uno: str = "",
) -> Options:
    """Return the schedule of a seed.

    Parameters
    ----------
    only : sequence of str
        Faults to draw from.
    stalls : bool, optional
        The emulator is also stalled, by 20 to 500 ms, and tolerates it or does not; no other
        option depends on this. By default it is not stalled.
    c_core : bool
        The device's firmware is the C core; no other option depends on this.
    uno : str
        The device is an Uno with this image; its own properties are not drawn.
    """
    rng, of_law = Random(seed), Random(seed ^ 0x1A33)
    ts_us = rng.choices(list(_TS_US), list(_TS_US.values()))[0]
    has_law = of_law.random() < _LAWS
    ts_us = of_law.choice(_LAW_TS_US) if has_law else ts_us
    narrow = rng.random() < 0.3
    episodes = [_episode(rng, only) for _ in range(rng.randint(3, 8))]
    lines = [kind for kind in only if " " in kind]
    if lines and rng.random() < 0.4:
        kind = rng.choice(lines)
        whole = CLEAR_NS - _FIRST_NS
        episodes.append(Episode(kind, _FIRST_NS, whole, 0.03 * rng.random()))
    kept = sorted(episodes, key=lambda e: e.t_ns)
    slow_device = ts_us >= 5_000
    drawn = Options(
        seed=seed,
        ts_us=ts_us,
        watchdog_ms=rng.choice([100, 100, 100, 50, 250]) if slow_device else 100,
        u_min=rng.randint(0, 6_000) if narrow else 0,
        u_max=rng.randint(50_000, 65_535) if narrow else 65_535,
        slew=rng.choice([0, 0, 15_000, 15_000, 40_000]),
        turns=rng.choice([0, 0, 50, 100, 1_000]),
        rail_ticks=rng.choice([0, 0, 8, 30]),
        stop_after=rng.choice([0, 0, 3]),
        service_ns=rng.choice([0, 400 * MS]),
        boot_ms=rng.choice([0.0, 5.0, 50.0]),
        pwm_bits=rng.choice([10, 10, 10, 8, 16, 0]),
        queue=(512, 256)[seed % 2],
        adc_noise_v=rng.choice([0.0, 0.0, 0.0, 0.0025]),
        clock_ppm=rng.choice([0.0, rng.uniform(-100, 100), rng.uniform(-100, 100)]),
        clock_start_us=rng.choice([0, 0, (1 << 32) - rng.randint(1, END_NS // 1_100)]),
        usb_ns=rng.choice([0, 0, 0, 1 * MS]) if slow_device else 0,
        client_ns=rng.randint(12, 60) * MS,
        modes=tuple(rng.choices(["hold", "exchange", "scheduled"], k=12)),
        goes_on=rng.random() < 0.4,
        real_outbox=any(e.kind == "full_pipe" for e in kept),
        episodes=tuple(kept),
        outputs=draw_outputs(Random(seed ^ 0x0075), ts_us),
        stalls=() if stalls is None else _stalls(Random(seed ^ 0x57A11)),
        tolerates_stalls=bool(stalls),
        c_core=c_core,
    )
    of_rest = Random(seed ^ 0x2E57)
    if uno:  # a shield has no enable line, so its rest is 0 V
        drawn = replace(drawn, uno=uno, pwm_bits=LAYOUTS[uno].pwm_bits, **_UNO)
    elif of_rest.random() < 0.4:
        rests = (drawn.u_max // 2, drawn.u_max, max(drawn.u_min, 6_554))
        drawn = replace(drawn, rest=of_rest.choice(rests))
    # A law keeps rest within its limits, and its limits within those of the rig.
    if has_law and drawn.u_min <= drawn.rest:
        of_mode = [of_law.random() for _ in drawn.modes]
        names = ["control" if p < 0.8 else "own" if p < 0.9 else "" for p in of_mode]
        modes = [name or mode for name, mode in zip(names, drawn.modes, strict=True)]
        drawn = replace(drawn, modes=tuple(modes))
    return drawn


def _stalls(rng: Random) -> tuple[Episode, ...]:
    """Return 4 to 12 stalls, which may meet the other faults."""
    drawn = []
    for _ in range(rng.randint(4, 12)):
        for_ns = round(20 * MS * 25 ** rng.random())
        t_ns = round(rng.uniform(_FIRST_NS, CLEAR_NS - 200 * MS - for_ns))
        drawn.append(Episode("stall", t_ns, for_ns, rng.random()))
    return tuple(sorted(drawn, key=lambda e: e.t_ns))


def _episode(rng: Random, only: Sequence[str]) -> Episode:
    weights = [_WEIGHTS.get(kind, 1.0) for kind in only]
    kind = rng.choices(only, weights)[0]
    share = rng.random()
    for_ns = round(5 * MS * 120**share)  # 5 to 600 ms, as many short as long ones
    if kind == "slow_service":
        for_ns = round(600 * MS * share)  # only a long one is a frozen one
    lasts_ns = 600 * MS if kind == "old_frames" else for_ns  # they are played one by one
    t_ns = round(rng.uniform(_FIRST_NS, CLEAR_NS - 100 * MS - lasts_ns))
    return Episode(kind, t_ns, for_ns, rng.random())
