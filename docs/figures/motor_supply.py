"""Computes the tables of docs/hardware.md on the motor's supply, and prints them.

The arm is `armrig_core.rig.arm` with the handout's values. Values of parts are constants below,
each with its source. "Memory" means that nobody compared the value with the data sheet.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from armrig_core.rig.arm import ArmParameters, arm_matrices, zero_order_hold
from numpy.typing import NDArray

Vector = NDArray[np.float64]
V_SUPPLY = 5.0
ARM = ArmParameters()
BACK_EMF = ARM.N * ARM.K_m
"""Back-EMF for the rate of the chassis, in Vs/rad."""

BLEEDER_OHM = 15.0 / 2  # R7 and R8, 15 Ω each
CAPACITOR_F = 1000e-6  # C2
DRIVER_A = 0.010  # memory: DRV8874, 4 mA, rounded up
SENSE_OHM = 22e3  # R1 and R2

FUSE_A = 2.5
FUSE_I2T = 12.0  # A²s until it melts; memory: 5 × 20 mm, F, 2.5 A, 8 to 14 A²s by maker
FUSE_GATES = (
    (1.5, "at least 1 h"),
    (2.1, "at most 30 min"),
    (2.75, "at most 2 s"),
    (4, "at most 0.3 s"),
    (10, "at most 20 ms"),
)
"""Multiples of the rating and the time to blow: IEC 60127-2, F; memory."""

# The path from the supply to the driver, in Ω; memory: typical values.
PATH_OHM = {
    "cable, 2 × 0.5 m of 0.75 mm²": 0.024,
    "fuse": 0.030,
    "switch": 0.030,
    "board and carrier": 0.030,
}
DRIVER_LEAST_V = 4.5  # data sheet DRV8874 (SLVSF66A): 4.5 to 37 V

TRIP_REFERENCE_V = (2.470, 2.495, 2.520)  # TL431A, 1 %; memory
TRIP_R1, TRIP_R2 = 12e3, 10e3  # 1 % each
TRIP_INPUT_A = 2e-6  # TL431's reference input; memory
FILTER_S = 2.2e-9 * TRIP_R1 * TRIP_R2 / (TRIP_R1 + TRIP_R2)
TRIGGER_S = 5e-6  # TL431, Q2 and the thyristor's 2 µs; memory but for the 2 µs

# Data sheet BT151-500R (NXP, rev. 5): 1.75 V at 23 A at most, 120 A for 10 ms, Tj 125 °C,
# 1.3 K/W to the tab; I²t 72 A²s, with other makers 50 A²s.
THYRISTOR_V, THYRISTOR_OHM = 1.0, 0.033
THYRISTOR_I2T = 50.0
TO_TAB_KW = 1.3 + 0.5  # and 0.5 K/W from the tab to the heat sink
HEAT_SINK_KW = 7.0
ROOM_C = 40.0

SOURCES = (
    ("plug-in supply, 12 V, limit 1 A, 470 µF in it", 0.15, 1.0, 470e-6),
    ("table supply, 12 V, limit 4 A, 1000 µF in it", 0.10, 4.0, 1000e-6),
    ("desktop supply, 12 V, limit 7 A, 2200 µF in it", 0.08, 7.0, 2200e-6),
    ("PC supply or lead battery, 12 V, no limit below 100 A", 0.12, None, None),
)
"""What may be plugged in by mistake: name, resistance, limit in A, capacitor in F."""


def step_back_emf() -> float:
    """Return the largest back-EMF after a step of 5 V from standstill, in V."""
    Phi, Gamma = zero_order_hold(*arm_matrices(ARM)[:2], 1e-3)
    x, largest = np.zeros(4), 0.0
    for _ in range(600):
        x = Phi @ x + Gamma[:, 0] * V_SUPPLY
        largest = max(largest, BACK_EMF * float(x[2]))
    return largest


def worst_input() -> Vector:
    """Return the input of 0 and 5 V, each held for 1 ms, that ends at the largest back-EMF.

    The back-EMF is the convolution of u with an impulse response: 5 V where that is positive.
    """
    Phi, Gamma = zero_order_hold(*arm_matrices(ARM)[:2], 1e-3)
    response, x = [], Gamma[:, 0].copy()
    for _ in range(1000):
        response.append(x[2])
        x = Phi @ x
    return np.where(np.array(response[::-1]) > 0, V_SUPPLY, 0.0)


def after(u: Vector) -> Vector:
    """Return the state of the arm after an input that starts at standstill, 1 ms a value."""
    Phi, Gamma = zero_order_hold(*arm_matrices(ARM)[:2], 1e-3)
    x = np.zeros(4)
    for volts in u:
        x = Phi @ x + Gamma[:, 0] * volts
    return x


def fed_back(emf: float) -> float:
    """Return the largest current into the supply at that back-EMF, in A.

    Of duty d it is d (emf - 5 d) / R_m, and largest at d = emf / 10 V.
    """
    return emf**2 / (4 * V_SUPPLY * ARM.R_m)


def highest_rail(x: Vector, bleeder: float) -> float:
    """Return the highest voltage of the rail if the duty falls and the supply takes no current."""
    h, highest = 1e-4, V_SUPPLY
    Phi, Gamma = zero_order_hold(*arm_matrices(ARM)[:2], h)
    for duty in (0.5, 0.6, 0.7):
        state, v = x, V_SUPPLY
        for _ in range(400):
            fed = -duty * (duty * v - BACK_EMF * state[2]) / ARM.R_m
            v = max(V_SUPPLY, v + h / CAPACITOR_F * (fed - v / bleeder))
            state = Phi @ state + Gamma[:, 0] * (duty * v)
            highest = max(highest, v)
    return float(highest)


def trip_voltages() -> tuple[float, float, float]:
    """Return the least, the nominal and the largest voltage at which the crowbar fires."""
    return tuple(
        reference * (1 + TRIP_R1 * a / (TRIP_R2 / a)) + TRIP_INPUT_A * TRIP_R1
        for reference, a in zip(TRIP_REFERENCE_V, (0.99, 1.0, 1.01), strict=True)
    )  # type: ignore[return-value]


def gate_current() -> float:
    """Return the current into the thyristor's gate at the least voltage that fires it, in A.

    The TL431 falls to 2 V, the base is 0.7 V below the rail, Q2 saturates at 0.2 V, the gate is at
    1 V (memory); R3 330 Ω, R4 470 Ω, R5 100 Ω, R6 220 Ω. Q2 needs a gain of 8; it has 160.
    """
    rail = trip_voltages()[0]
    base = (rail - 0.7 - 2.0) / 330 - 0.7 / 470
    return min(160 * base, (rail - 0.2 - 1.0) / 100) - 1.0 / 220


def crowbar(ohm: float, limit: float | None, charge: float | None) -> tuple[float, ...]:
    """Apply 12 V to a rail at 5 V; return its peak, its time above 5.25 V, and two currents.

    Euler, 50 ns, 2 ms; in V, µs and A. The currents are the thyristor's peak, and what lasts. The
    resistance in C2 and the inductance of the wires, which lower the peak current, are left out.
    """
    h, v, source, filtered = 5e-8, V_SUPPLY, 12.0, V_SUPPLY
    trip, fires_at, peak, above, current, largest = trip_voltages()[2], None, v, 0.0, 0.0, 0.0
    for n in range(40_000):
        in_a = (source - v) / (ohm + PATH_OHM["fuse"])
        if charge is not None and limit is not None:
            source = min(12.0, source + h / charge * (limit - in_a))
        filtered += h / FILTER_S * (v - filtered)
        if fires_at is None and filtered > trip:
            fires_at = n * h + TRIGGER_S
        current = 0.0
        if fires_at is not None and n * h > fires_at:
            current = max(0.0, (v - THYRISTOR_V) / (THYRISTOR_OHM + PATH_OHM["switch"]))
        v += h / CAPACITOR_F * (in_a - current - v / BLEEDER_OHM)
        peak, largest, above = max(peak, v), max(largest, current), above + h * (v > 5.25)
    return peak, above * 1e6, largest, in_a if limit is None else limit


def fuse_time(amperes: float) -> str:
    """Return how soon the fuse blows: by its I²t from ten ratings on, by the standard below."""
    if amperes > 10 * FUSE_A:
        return f"{FUSE_I2T / amperes**2 * 1e3:.0f} ms"
    known = [time for multiple, time in FUSE_GATES[1:] if amperes >= multiple * FUSE_A]
    return known[-1] if known else "need not blow"


def thyristor_power(amperes: float) -> float:
    """Return the power in the thyristor at a constant current, in W."""
    return amperes * (THYRISTOR_V + THYRISTOR_OHM * amperes)


def turn_after_stop(ohm: float, diode: float) -> tuple[float, float]:
    """Return the turn in rad and the time in s until the back-EMF is 0.1 V above the diode's.

    From the speed at 5 V without friction, arm and chassis as one inertia; a current flows while
    the back-EMF is above `diode`, in V, through `ohm` and R_m.
    """
    h, rate, turn, t = 1e-4, V_SUPPLY / BACK_EMF, 0.0, 0.0
    while BACK_EMF * rate > diode + 0.1:
        rate -= h * BACK_EMF * (BACK_EMF * rate - diode) / (ohm + ARM.R_m) / (ARM.J_1 + ARM.J_2)
        turn, t = turn + h * rate, t + h
    return turn, t


def currents() -> Iterator[tuple[str, str]]:
    """Yield the rows of the table of currents in use."""
    emf = BACK_EMF * float(after(worst_input())[2])
    stands, bleeds = V_SUPPLY / ARM.R_m, V_SUPPLY / BLEEDER_OHM
    rest = DRIVER_A + V_SUPPLY / SENSE_OHM
    # The input's mirror image ends at 5 V - emf, the most negative back-EMF; then u is 5 V.
    largest = emf / ARM.R_m
    path = sum(PATH_OHM.values())
    at_driver = V_SUPPLY - path * (largest + bleeds + rest)
    yield "motor at standstill, at 5 V: 5 V/R_m", f"{stands:.2f} A"
    yield "bleeder, 5 V/7.5 Ω", f"{bleeds:.2f} A"
    yield "driver and crowbar at rest", f"{rest:.2f} A"
    yield "**continuous sum**", f"**{stands + bleeds + rest:.2f} A**"
    turned = f"5 V at a motor that turns backwards: (5 V + {emf - V_SUPPLY:.2f} V)/R_m"
    yield f"{turned}, for less than 0.1 s", f"{largest:.2f} A"
    yield "**sum for less than 0.1 s**", f"**{largest + bleeds + rest:.2f} A**"
    name = f"voltage at the driver at {largest + bleeds + rest:.2f} A, after {path * 1e3:.0f} mΩ"
    yield f"{name} (the driver needs at least {DRIVER_LEAST_V} V)", f"{at_driver:.2f} V"


def feedback() -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table of the current that a braked motor feeds back."""
    cases = (
        ("5 V until the speed is constant", after(np.full(1500, V_SUPPLY))),
        ("5 V from standstill, for 0.3 s", after(np.full(303, V_SUPPLY))),
        ("the worst input of 0 and 5 V", after(worst_input())),
    )
    for name, x in cases:
        emf = BACK_EMF * float(x[2])
        rails = [f"{highest_rail(x, ohm):.2f} V" for ohm in (15.0, 10.0, BLEEDER_OHM)]
        yield name, f"{emf:.2f} V", f"{fed_back(emf):.2f} A", *rails


def wrong_supply() -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table of 12 V applied by mistake."""
    for name, ohm, limit, charge in SOURCES:
        peak, above, largest, lasting = crowbar(ohm, limit, charge)
        watts = thyristor_power(lasting)
        currents_a = f"{largest:.0f} A", f"{lasting:.0f} A"
        yield (
            name,
            f"{peak:.2f} V",
            f"{above:.0f} µs",
            *currents_a,
            f"{watts:.0f} W",
            fuse_time(lasting),
        )


def powers() -> Iterator[tuple[str, str, str]]:
    """Yield the rows of the table of power."""
    stands = V_SUPPLY / ARM.R_m
    longest = 2.75 * FUSE_A
    watts = thyristor_power(longest)
    hot = ROOM_C + watts * (TO_TAB_KW + HEAT_SINK_KW)
    yield "R7 and R8, each, always", f"{V_SUPPLY**2 / 15:.2f} W", "5 W"
    yield (
        "driver, 0.1 Ω, motor at standstill at 5 V",
        f"{0.1 * stands**2:.2f} W",
        "its carrier: 2.1 A continuously",
    )
    yield "motor at standstill", f"{V_SUPPLY**2 / ARM.R_m:.1f} W", "unknown: do not block the motor"
    name = f"thyristor at {longest:.1f} A, the most that the fuse may carry for 30 min"
    yield (
        name,
        f"{watts:.1f} W",
        f"{hot:.0f} °C with a heat sink of {HEAT_SINK_KW:.0f} K/W; limit 125 °C",
    )


def stops() -> Iterator[tuple[str, str, str]]:
    """Yield the rows of the table of stops."""
    for name, ohm, diode in (
        ("u = 0 in a run: the driver brakes", 0.1, 0.0),
        (
            "emergency stop: the driver sleeps, its diode conducts into the bleeder",
            BLEEDER_OHM,
            0.7,
        ),
    ):
        turn, seconds = turn_after_stop(ohm, diode)
        yield name, f"{turn:.2f} rad", f"{seconds:.2f} s"
    name = "`armrig stop`, end of a run: the driver sleeps, the supply is on"
    yield name, "depends on friction", "depends on friction"


TABLES = {
    "currents": ("in use | at 5.0 V", currents),
    "feedback": (
        "input before the duty falls | back-EMF | fed back"
        " | rail with 15 Ω | rail with 10 Ω | rail with 7.5 Ω",
        feedback,
    ),
    "wrong supply": (
        "12 V by mistake | peak voltage | time above 5.25 V"
        " | thyristor, peak | continuous | power | fuse blows",
        wrong_supply,
    ),
    "powers": ("part | power | rating", powers),
    "stops": ("from 5 V, without friction | turn | time", stops),
}


def table(name: str) -> str:
    """Return one table as the page has it."""
    head, rows = TABLES[name]
    lines = [head, "|".join("---" for _ in head.split(" | ")), *(" | ".join(row) for row in rows())]
    return "".join(f"|{line}|\n" if set(line) <= set("-|") else f"| {line} |\n" for line in lines)


if __name__ == "__main__":
    print(
        "trip", *(f"{volts:.2f} V" for volts in trip_voltages()), f"{gate_current() * 1e3:.0f} mA"
    )
    for name in TABLES:
        print(name, table(name), sep="\n")
