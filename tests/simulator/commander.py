"""Commanders: one with the lease, and intruders."""

from __future__ import annotations

from random import Random
from struct import pack, unpack

from armrig_core.rig.calibration import Calibration, Driver, Potentiometer
from armrig_daemon.pipe import (
    Answer,
    Arm,
    Calibrate,
    Disarm,
    Order,
    Record,
    Reset,
    Run,
    RunEnded,
    Set,
    SetReference,
    Stop,
)
from armrig_daemon.pipe import State as StateRecord
from msgspec import UNSET

from tests.simulator.laws import draw_law
from tests.simulator.options import Options

_OTHER = Calibration(theta_1=Potentiometer(rad_per_count=-0.1), driver=Driver(gain=10.0))
_REFERENCES = 0.3  # share of the acts in a run in control
_PATIENCE = 20
"""Acts after which an answer that has not come is no longer awaited."""


class Commander:
    """Takes the rig, drives it by hand or by experiments, and recovers from trips."""

    def __init__(self, options: Options, rng: Random) -> None:
        """Begin with nothing known."""
        self._options, self._rng = options, rng
        self._phase = "init"
        self._lease = ""
        self._number = 0
        self._n = 0
        self._held = False
        self._waits = 0
        self._awaited = -1
        self._grants = 0
        self._code = options.rest
        self._playing = False
        self._holds_left = 0
        self._references = Random(0)
        self._r_range: tuple[float, float] | None = None

    @property
    def lease(self) -> str:
        """Lease of its last arming."""
        return self._lease

    def hears(self, record: Record) -> None:
        """Read a record of the daemon."""
        if isinstance(record, StateRecord):
            self._phase = record.phase
            if record.phase not in ("armed", "active"):
                self._held = self._playing = False
        elif isinstance(record, RunEnded):
            self._playing = False
        elif isinstance(record, Answer) and record.order == self._awaited >= 0:
            self._awaited = -1
            if record.error:
                self._playing = False
            elif "lease" in record.body:
                self._held = True

    def forget(self) -> None:
        """Begin again with another daemon."""
        self._phase, self._held, self._playing, self._awaited = "init", False, False, -1

    def act(self) -> Order | None:
        """Return its present orders."""
        if self._awaited >= 0 and self._waits < _PATIENCE:
            self._waits += 1
            return None
        if self._phase == "fault":
            return self._await(Reset(order=self._next()))
        if self._phase == "safe" and not self._held:
            return self._await(self._arm())
        if self._held and self._playing and self._r_range is not None:
            return self._another_reference(*self._r_range)
        if self._held and self._playing and self._mode() == "own":
            return self._set_voltage()
        if not self._held or self._playing:
            return None
        if self._mode() == "hold":
            return self._set_voltage()
        self._n += 1
        self._playing = True
        is_control = self._mode() in ("control", "own")
        codes = [] if is_control else self.codes()
        law, reference = draw_law(self._rng, self._options) if is_control else (UNSET, UNSET)
        law = UNSET if self._mode() == "own" else law
        self._r_range = None
        if law and reference:
            # Of a generator of its own: the schedule is the same without further references.
            self._references = Random(reference)
            values = unpack(f"<{len(reference) // 8}d", reference)
            self._r_range = min(values), max(values)
        return self._await(
            Run(
                order=self._next(),
                lease=self._lease,
                n=self._n,
                run_id=f"r{self._number}",
                codes=pack(f"<{len(codes)}H", *codes),
                scheduled=self._mode() == "scheduled",
                law=law,
                reference=reference,
                r_range=self._r_range or (0.0, 0.0),
            )
        )

    def _another_reference(self, low: float, high: float) -> Order | None:
        """Return a reference for the run in control, often, and sometimes one out of its range."""
        if self._references.random() > _REFERENCES:
            return None
        self._n += 1
        beyond = self._references.choice([0.0, 0.0, 0.0, 0.1])
        r = self._references.uniform(low - beyond, high + beyond)
        return SetReference(order=self._next(), lease=self._lease, n=self._n, r=r)

    def forged(self) -> Order:
        """Return an order with a lease or a number that is not in force."""
        code = self._rng.randint(1, 65_535)
        what = self._rng.randrange(4)
        if what == 0:
            return Set(order=self._other(), lease="f" * 32, n=1 << 30, code=code)
        if what == 1:
            return Set(order=self._other(), lease="", n=1 << 30, code=code)
        if what == 2:
            return Disarm(order=self._other(), lease="e" * 32, n=1 << 30)
        return Set(
            order=self._other(), lease=self._lease, n=self._rng.randint(-5, self._n), code=code
        )

    def out_of_range(self) -> Order:
        """Return an order of the holder whose code no rig stands, or this one may not."""
        options = self._options
        codes = [-1, 65_536, 70_000, 1 << 40, -(1 << 40)]
        if options.u_max < 65_535:
            codes += [options.u_max + 1, 65_535] * 6
        if options.u_min:
            codes.append(options.u_min - 1)
        self._n += 1
        return Set(order=self._other(), lease=self._lease, n=self._n, code=self._rng.choice(codes))

    def intruded(self) -> Order:
        """Return the attempts of a second commander while another holds the rig."""
        what = self._rng.randrange(12)
        if what == 0:
            return Stop(order=self._other())
        if what < 6:
            return Arm(order=self._other(), owner="another", lease="b" * 32, ts_us=0)
        if what == 11:
            return Calibrate(order=self._other(), calibration=_OTHER)
        return Set(order=self._other(), lease="b" * 32, n=1 << 30, code=65_535)

    def codes(self) -> list[int]:
        """Return an experiment: steps within the limits; one half is soon at its end."""
        options, rng = self._options, self._rng
        low, high = max(options.u_min, not options.rest), options.u_max
        codes: list[int] = []
        last = options.rest
        for _ in range(rng.randint(2, rng.choice([6, 30]))):
            wanted = rng.randint(low, high)
            code = self._near(last, wanted)
            last = code
            codes += [code] * rng.randint(1, 40)
        return codes

    def _near(self, last: int, wanted: int) -> int:
        slew = self._options.slew
        if slew and abs(wanted - last) > slew:
            return last + slew if wanted > last else last - slew
        return wanted

    def _mode(self) -> str:
        modes = self._options.modes
        return modes[self._grants % len(modes)]

    def _arm(self) -> Arm:
        self._grants += 1
        self._n = 0
        self._code = self._options.rest
        self._holds_left = self._rng.randint(5, 60)
        self._lease = f"{self._rng.getrandbits(128):032x}"
        return Arm(order=self._next(), owner="a student", lease=self._lease, ts_us=0)

    def _set_voltage(self) -> Order:
        self._n += 1
        if self._holds_left <= 0:
            return self._await(Disarm(order=self._next(), lease=self._lease, n=self._n))
        self._holds_left -= 1
        options = self._options
        wanted = self._rng.randint(max(options.u_min, not options.rest), options.u_max)
        self._code = self._near(self._code, wanted)
        return Set(order=self._next(), lease=self._lease, n=self._n, code=self._code)

    def _next(self) -> int:
        self._number += 1
        return self._number

    def _other(self) -> int:
        """Return the number of another commander's order."""
        self._number += 1
        return -self._number

    def _await(self, order: Order) -> Order:
        self._awaited, self._waits = order.order, 0
        return order
