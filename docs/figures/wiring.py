"""Draws wiring.svg, board.svg and board-back.svg of docs/hardware.md beside itself.

`NETLIST` says what is connected. The two drawings are data of their own: where each pin is, and
where each line runs. `drawn` finds out what a drawing connects; a test compares it with `NETLIST`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import combinations, pairwise
from pathlib import Path
from typing import NamedTuple

FOLDER = Path(__file__).parent
Point = tuple[int, int]
Line = tuple[Point, ...]

PARTS = {
    "F1": "2.5 A F",
    "D1": "MBR1645",
    "Q1": "BT151",
    "Q2": "BC327",
    "U1": "TL431A",
    "U2": "DRV8874",
    "R1": "12 kΩ",
    "R2": "10 kΩ",
    "R3": "330 Ω",
    "R4": "470 Ω",
    "R5": "100 Ω",
    "R6": "220 Ω",
    "R7": "15 Ω 5 W",
    "R8": "15 Ω 5 W",
    "R9": "10 kΩ",
    "R10": "10 kΩ",
    "R11": "10 kΩ",
    "R12": "1 kΩ",
    "R13": "1 MΩ",
    "R14": "1 kΩ",
    "R15": "1 MΩ",
    "C1": "2.2 nF",
    "C2": "1000 µF",
    "C3": "100 nF",
    "C4": "10 nF",
    "C5": "10 nF",
}
"""Each part on the board and its value; the link W1 is a wire."""

NETLIST = {
    "supply": "supply.+ F1.1",
    "fused": "F1.2 D1.K Q1.A Q2.E R1.1 R4.1 S1.1",
    "motor supply": "S1.2 R7.1 R8.1 C2.+ C3.1 U2.VIN",
    "motor": "U2.OUT2 M.+",
    "power ground": "supply.- D1.A Q1.K U1.A R2.2 C1.2 R6.2 C2.- C3.2 R7.2 R8.2 U2.GND U2.GND2 "
    "U2.PH U2.PMODE R9.2 R10.2 R11.2 M.- W1.1",
    "reference": "R1.2 R2.1 C1.1 U1.REF",
    "sink": "U1.K R3.1",
    "base": "R3.2 R4.2 Q2.B",
    "collector": "Q2.C R5.1",
    "gate": "R5.2 R6.1 Q1.G",
    "PWM": "Uno.D9 U2.EN R9.1",
    "enable": "Uno.D7 U2.SLEEP R10.1",
    "current limit": "U2.VREF R11.1",
    "signal ground": "W1.2 Uno.GND theta_1.GND alpha.GND R13.2 C4.2 R15.2 C5.2 S1.4",
    "5 V of the Uno": "Uno.5V theta_1.5V alpha.5V",
    "wiper of theta_1": "theta_1.W R12.1",
    "wiper of alpha": "alpha.W R14.1",
    "A0": "R12.2 R13.1 C4.1 Uno.A0",
    "A1": "R14.2 R15.1 C5.1 Uno.A1",
    "reset": "Uno.RESET S1.3",
}
OFF_BOARD = {"S1.3", "S1.4", "Uno.RESET"}
"""The second contact of the emergency stop: two wires from the switch to the Uno."""


def netlist(without: Iterable[str] = ()) -> set[frozenset[str]]:
    """Return the pins of each net; nets of less than two pins are left out."""
    nets = (frozenset(pins.split()) - frozenset(without) for pins in NETLIST.values())
    return {net for net in nets if len(net) > 1}


class Drawing(NamedTuple):
    """Where the pins are, and the lines between them."""

    pins: dict[str, Point]
    lines: list[Line]
    """Conductors. On the board they also touch where they cross."""
    wires: list[Line]
    """Insulated wires, which touch at their ends alone."""
    labels: dict[str, list[Point]]
    """Points that are connected because they have the same symbol."""
    pitch: int
    crossings_touch: bool


def points(line: Line, pitch: int) -> set[Point]:
    """Return all grid points on a line, which runs parallel to an axis."""
    found = {line[0]}
    for (x0, y0), (x1, y1) in pairwise(line):
        n = max(abs(x1 - x0), abs(y1 - y0)) // pitch
        if min(abs(x1 - x0), abs(y1 - y0)) or n * pitch != abs(x1 - x0) + abs(y1 - y0):
            raise ValueError(f"the line {line} must run along the grid of {pitch}")
        found |= {(x0 + (x1 - x0) * k // n, y0 + (y1 - y0) * k // n) for k in range(n + 1)}
    return found


def drawn(drawing: Drawing) -> set[frozenset[str]]:
    """Return the pins of each net as the drawing connects them."""
    pieces: list[tuple[set[Point], set[Point], set[str]]] = []  # ends, all points, pins
    for line in drawing.lines:
        pieces.append(({line[0], line[-1]}, points(line, drawing.pitch), set()))
    for joined in [*((w[0], w[-1]) for w in drawing.wires), *drawing.labels.values()]:
        pieces.append((set(joined), set(joined), set()))
    for pin, point in drawing.pins.items():
        pieces.append(({point}, {point}, {pin}))
    groups = list(range(len(pieces)))
    for a, b in combinations(range(len(pieces)), 2):
        (ends_a, all_a, _), (ends_b, all_b, _) = pieces[a], pieces[b]
        touches = all_a & all_b if drawing.crossings_touch else (ends_a & all_b) | (ends_b & all_a)
        if touches:
            old, new = groups[a], groups[b]
            groups = [new if group == old else group for group in groups]
    nets: dict[int, frozenset[str]] = {}
    for group, (_, _, pins) in zip(groups, pieces, strict=True):
        nets[group] = nets.get(group, frozenset()) | pins
    return {net for net in nets.values() if len(net) > 1}


# The board: columns from 1, rows from 1, 2.54 mm apart, seen from the parts' side.

COLUMNS, ROWS = 61, 34
NOT_CONNECTED = {
    "U2.VM": (54, 5),
    "U2.OUT1": (59, 7),
    "U2.IMODE": (59, 9),
    "U2.FAULT": (59, 10),
    "U2.CS": (59, 11),
}
BOARD = Drawing(
    pitch=1,
    crossings_touch=True,
    pins={
        **{"supply.+": (2, 4), "supply.-": (2, 6), "F1.1": (4, 4), "F1.2": (13, 4)},
        **{"S1.1": (34, 2), "S1.2": (36, 2), "M.-": (58, 32), "M.+": (60, 32)},
        **{"D1.K": (7, 16), "D1.A": (9, 16), "Q1.K": (13, 16), "Q1.A": (14, 16), "Q1.G": (15, 16)},
        **{"R6.1": (20, 16), "R6.2": (20, 20), "R5.1": (22, 12), "R5.2": (22, 16)},
        **{"Q2.C": (24, 12), "Q2.B": (25, 12), "Q2.E": (26, 12)},
        **{"R4.1": (28, 9), "R4.2": (28, 13), "R3.2": (24, 13), "R3.1": (24, 17)},
        **{"U1.K": (26, 17), "U1.A": (27, 17), "U1.REF": (28, 17)},
        **{"R1.1": (30, 9), "R1.2": (30, 13), "R2.1": (30, 16), "R2.2": (30, 20)},
        **{"C1.1": (32, 18), "C1.2": (32, 20), "C2.+": (37, 12), "C2.-": (37, 14)},
        **{"R7.1": (42, 6), "R7.2": (42, 18), "R8.1": (47, 6), "R8.2": (47, 18)},
        **{"U2.GND": (54, 6), "U2.EN": (54, 7), "U2.PH": (54, 8), "U2.PMODE": (54, 9)},
        **{"U2.SLEEP": (54, 10), "U2.VREF": (54, 11), "U2.VIN": (59, 5), "U2.GND2": (59, 6)},
        **{"U2.OUT2": (59, 8), "C3.1": (61, 4), "C3.2": (61, 6), **NOT_CONNECTED},
        **{"R9.1": (51, 16), "R9.2": (51, 20), "R10.1": (53, 16), "R10.2": (53, 20)},
        **{"R11.1": (55, 16), "R11.2": (55, 20), "W1.1": (56, 20), "W1.2": (56, 23)},
        **{"theta_1.5V": (13, 32), "theta_1.W": (15, 32), "theta_1.GND": (17, 32)},
        **{"R12.1": (15, 27), "R12.2": (19, 27), "C4.1": (21, 25), "C4.2": (21, 23)},
        **{"R13.1": (23, 27), "R13.2": (23, 23)},
        **{"alpha.5V": (29, 32), "alpha.W": (31, 32), "alpha.GND": (33, 32)},
        **{"R14.1": (31, 27), "R14.2": (35, 27), "C5.1": (37, 25), "C5.2": (37, 23)},
        **{"R15.1": (39, 27), "R15.2": (39, 23)},
        **{"Uno.A1": (41, 32), "Uno.A0": (43, 32), "Uno.5V": (45, 32), "Uno.GND": (47, 32)},
        **{"Uno.D9": (49, 32), "Uno.D7": (51, 32)},
    },
    lines=[
        *[((2, 4), (4, 4)), ((13, 4), (34, 4), (34, 2)), ((14, 4), (14, 16))],
        *[((7, 16), (7, 14), (14, 14)), ((26, 4), (26, 12)), ((28, 4), (28, 9))],
        *[((30, 4), (30, 9)), ((36, 2), (36, 4), (61, 4)), ((37, 4), (37, 12))],
        *[((42, 4), (42, 6)), ((47, 4), (47, 6)), ((59, 4), (59, 5))],
        *[((2, 6), (2, 20), (57, 20)), ((9, 16), (9, 20)), ((13, 16), (13, 20))],
        *[((27, 17), (27, 20)), ((37, 14), (37, 20)), ((42, 18), (42, 20)), ((47, 18), (47, 20))],
        *[((54, 6), (61, 6)), ((55, 6), (55, 9), (54, 9)), ((54, 8), (55, 8))],
        *[((57, 6), (57, 30), (58, 30), (58, 32)), ((59, 8), (60, 8), (60, 32))],
        *[((15, 16), (22, 16)), ((22, 12), (24, 12)), ((25, 12), (25, 13)), ((24, 13), (28, 13))],
        *[((24, 17), (26, 17)), ((28, 17), (32, 17), (32, 18)), ((30, 13), (30, 17))],
        *[((54, 7), (50, 7)), ((51, 7), (51, 16)), ((54, 10), (53, 10), (53, 16))],
        *[((53, 12), (52, 12)), ((54, 11), (54, 15), (55, 15), (55, 16))],
        *[((50, 29), (49, 29), (49, 32)), ((52, 29), (51, 29), (51, 32))],
        *[((17, 23), (56, 23)), ((17, 32), (17, 23)), ((33, 32), (33, 23)), ((47, 32), (47, 23))],
        *[((15, 32), (15, 27)), ((19, 27), (25, 27), (25, 28)), ((21, 27), (21, 25))],
        *[((31, 32), (31, 27)), ((35, 27), (41, 27), (41, 32)), ((37, 27), (37, 25))],
        *[((43, 28), (43, 32)), ((13, 32), (13, 29)), ((28, 29), (30, 29)), ((29, 29), (29, 32))],
        ((45, 29), (45, 32)),
    ],
    labels={},
    wires=[
        ((50, 7), (50, 29)),
        ((52, 12), (52, 29)),
        ((25, 28), (43, 28)),
        ((13, 29), (28, 29)),
        ((30, 29), (45, 29)),
    ],
)

# The circuit diagram, in steps of 10.

KINDS = {
    "resistor": {"1": (0, -20), "2": (0, 20)},
    "resistor up": {"2": (0, -20), "1": (0, 20)},
    "resistor across": {"2": (-20, 0), "1": (20, 0)},
    "fuse": {"1": (-30, 0), "2": (30, 0)},
    "capacitor": {"1": (0, -20), "2": (0, 20)},
    "electrolytic": {"+": (0, -20), "-": (0, 20)},
    "diode": {"K": (0, -20), "A": (0, 20)},
    "thyristor": {"A": (0, -20), "K": (0, 20), "G": (30, 10)},
    "pnp": {"E": (0, -30), "C": (0, 30), "B": (30, 0)},
    "reference": {"K": (0, -20), "A": (0, 20), "REF": (20, 0)},
    "opens": {"1": (-30, 0), "2": (30, 0)},
    "closes": {"3": (-30, 0), "4": (30, 0)},
    "link": {"1": (-20, 0), "2": (20, 0)},
    "potentiometer": {"5V": (0, -20), "GND": (0, 20), "W": (-30, 0)},
    "motor": {"+": (0, -30), "-": (0, 30)},
}
"""Of each symbol its pins, from its centre."""
SYMBOLS = (
    *(("F1", "fuse", 160, 100), ("D1", "diode", 230, 230), ("Q1", "thyristor", 310, 230)),
    *(("R6", "resistor", 370, 300), ("R5", "resistor across", 430, 240), ("Q2", "pnp", 480, 190)),
    *(("R4", "resistor", 540, 150), ("R3", "resistor up", 540, 240), ("U1", "reference", 540, 310)),
    *(("R1", "resistor", 640, 170), ("R2", "resistor", 640, 320), ("C1", "capacitor", 730, 320)),
    *(("S1", "opens", 790, 100), ("R7", "resistor", 840, 230), ("R8", "resistor", 910, 230)),
    *(("C2", "electrolytic", 980, 230), ("C3", "capacitor", 1070, 230), ("M", "motor", 1440, 230)),
    *(("R9", "resistor", 1060, 580), ("R10", "resistor", 980, 680), ("R11", "resistor", 1340, 460)),
    *(("W1", "link", 640, 420), ("S1", "closes", 300, 500)),
    *(("R12", "resistor across", 500, 760), ("R13", "resistor", 400, 800)),
    *(("C4", "capacitor", 290, 800), ("theta_1", "potentiometer", 580, 760)),
    *(("R14", "resistor across", 500, 920), ("R15", "resistor", 400, 960)),
    *(("C5", "capacitor", 290, 960), ("alpha", "potentiometer", 580, 920)),
)
BOXES = {
    "supply": (20, 60, 60, 340),
    "Uno": (40, 460, 140, 500),
    "U2": (1150, 60, 220, 330),
}
"""Left, top, width and height."""
DIAGRAM = Drawing(
    pitch=10,
    crossings_touch=False,
    wires=[],
    pins={
        f"{name}.{pin}": (x + dx, y + dy)
        for name, kind, x, y in SYMBOLS
        for pin, (dx, dy) in KINDS[kind].items()
    }
    | {"supply.+": (80, 100), "supply.-": (80, 360), "U2.VIN": (1150, 100)}
    | {"U2.OUT2": (1370, 130), "U2.GND2": (1370, 320), "U2.EN": (1180, 390)}
    | {"U2.SLEEP": (1210, 390), "U2.PH": (1240, 390), "U2.PMODE": (1270, 390)}
    | {"U2.GND": (1300, 390), "U2.VREF": (1340, 390), "Uno.RESET": (180, 500)}
    | {"Uno.D9": (180, 550), "Uno.D7": (180, 650), "Uno.GND": (180, 600), "Uno.5V": (180, 700)}
    | {"Uno.A0": (180, 760), "Uno.A1": (180, 920)},
    lines=[
        *[((80, 100), (130, 100)), ((190, 100), (760, 100)), ((820, 100), (1150, 100))],
        *[((80, 360), (1120, 360), (1120, 370)), ((230, 100), (230, 210))],
        *[((230, 250), (230, 360)), ((310, 100), (310, 210)), ((310, 250), (310, 360))],
        *[((340, 240), (410, 240)), ((370, 240), (370, 280)), ((370, 320), (370, 360))],
        *[((450, 240), (480, 240), (480, 220)), ((480, 160), (480, 100)), ((540, 100), (540, 130))],
        *[((540, 170), (540, 220)), ((510, 190), (540, 190)), ((540, 260), (540, 290))],
        *[((540, 330), (540, 360)), ((640, 100), (640, 150)), ((640, 190), (640, 300))],
        *[((640, 340), (640, 360)), ((560, 310), (610, 310), (610, 250), (640, 250))],
        *[((640, 250), (730, 250), (730, 300)), ((730, 340), (730, 360))],
        *[((x, 100), (x, 210)) for x in (840, 910, 980, 1070)],
        *[((x, 250), (x, 360)) for x in (840, 910, 980, 1070)],
        *[((1370, 130), (1440, 130), (1440, 200)), ((1440, 260), (1440, 320), (1370, 320))],
        *[((1410, 320), (1410, 330)), ((1180, 390), (1180, 550), (180, 550))],
        *[((1060, 550), (1060, 560)), ((1060, 600), (1060, 610))],
        *[((1210, 390), (1210, 650), (180, 650))],
        *[
            ((980, 650), (980, 660)),
            ((980, 700), (980, 710)),
            ((1240, 390), (1240, 410), (1300, 410), (1300, 390)),
        ],
        *[((1270, 390), (1270, 410)), ((1300, 410), (1300, 420)), ((1340, 390), (1340, 440))],
        *[((1340, 480), (1340, 490)), ((600, 420), (620, 420)), ((600, 420), (600, 430))],
        *[((660, 420), (680, 420), (680, 430)), ((180, 500), (270, 500))],
        *[((330, 500), (350, 500), (350, 510)), ((180, 600), (220, 600), (220, 610))],
        *[((180, 700), (220, 700)), ((180, 760), (480, 760)), ((290, 760), (290, 780))],
        *[((400, 760), (400, 780)), ((520, 760), (550, 760)), ((180, 920), (480, 920))],
        *[((290, 920), (290, 940)), ((400, 920), (400, 940)), ((520, 920), (550, 920))],
    ],
    labels={
        "power ground": [
            (1120, 370),
            (1410, 330),
            (1060, 610),
            (980, 710),
            (1300, 420),
            (1340, 490),
            (600, 430),
        ],
        "signal ground": [
            (680, 430),
            (350, 510),
            (220, 610),
            (580, 780),
            (580, 940),
            (290, 820),
            (400, 820),
            (290, 980),
            (400, 980),
        ],
        "5V": [(220, 700), (580, 740), (580, 900)],
    },
)

STYLE = """<style>
  polyline, path, rect, circle { fill: none; stroke: #000; stroke-width: 1.6 }
  .dot, .full { fill: #000 }
  .box { fill: #fff }
  text { fill: #000 }
  .name { font-weight: bold }
  .note { font-size: 13px; fill: #444 }
  .small { font-size: 11.5px; paint-order: stroke; stroke: #fff; stroke-width: 3 }
  .hole { fill: #fff; stroke: #bbb; stroke-width: 1 }
  .lead { fill: #000; stroke: none }
  .open { fill: #fff; stroke-width: 1.6 }
  .body { fill: #fff; fill-opacity: 0.75; stroke-width: 1.4 }
  .plus, .ground, .out, .thin { stroke-linecap: round; stroke-linejoin: round }
  .plus { stroke: #c62828; stroke-width: 8 }
  .ground { stroke: #37474f; stroke-width: 8 }
  .out { stroke: #ef6c00; stroke-width: 8 }
  .thin { stroke: #2e7d32; stroke-width: 4 }
  .wire { stroke: #fff; stroke-width: 7 }
  .wire.core { stroke: #1565c0; stroke-width: 3.5; stroke-dasharray: 9 4 }
</style>"""
SHAPES = {
    "resistor": '<rect x="-8" y="-20" width="16" height="40" class="box"/>',
    "resistor across": '<rect x="-20" y="-8" width="40" height="16" class="box"/>',
    "fuse": '<rect x="-30" y="-8" width="60" height="16" class="box"/><path d="M-30,0 H30"/>',
    "capacitor": '<path d="M0,-20 V-4 M-14,-4 H14 M-14,4 H14 M0,4 V20"/>',
    "electrolytic": '<path d="M0,-20 V-6 M0,6 V20 M-14,2 H14 V6 H-14 Z" class="full"/>'
    '<path d="M-14,-6 H14 V-2 H-14 Z M8,-16 h8 m-4,-4 v8"/>',
    "diode": '<path d="M0,-20 V-9 M0,9 V20 M-12,-9 H12"/>'
    '<path d="M-11,9 H11 L0,-9 Z" class="full"/>',
    "thyristor": '<path d="M0,-20 V-9 M0,9 V20 M-12,9 H12 M4,9 L14,20 V10 H30"/>'
    '<path d="M-11,-9 H11 L0,9 Z" class="full"/>',
    "pnp": '<circle r="20" class="box"/>'
    '<path d="M0,-30 V-18 L8,-8 M8,8 L0,18 V30 M8,-14 V14 M8,0 H30"/>'
    '<path d="M8,-8 L-1,-11 L6,-17 Z" class="full"/>',
    "reference": '<path d="M0,-20 V-9 M0,9 V20 M-16,-4 L-11,-9 H12 V-14 M12,-9 L20,0"/>'
    '<path d="M-11,9 H11 L0,-9 Z" class="full"/>',
    "opens": '<path d="M-30,0 H-15 M15,0 H30 M-15,0 L18,-7 M15,0 V-9 M0,-4 V-22 M-9,-22 H9"/>',
    "closes": '<path d="M-30,0 H-15 M15,0 H30 M-15,0 L14,-12 M0,-6 V-22 M-9,-22 H9"/>',
    "link": '<path d="M-20,0 H20" style="stroke-width:5"/>',
    "potentiometer": '<rect x="-8" y="-20" width="16" height="40" class="box"/>'
    '<path d="M-30,0 H-14"/>'
    '<path d="M-8,0 l-10,-5 v10 z" class="full"/>',
    "motor": '<circle r="24" class="box"/>'
    '<path d="M0,-30 V-24 M0,24 V30"/>'
    '<text y="6" text-anchor="middle" class="name">M</text>',
}  # fmt: skip
SHAPES["resistor up"] = SHAPES["resistor"]
GROUNDS = {
    "power ground": '<path d="M0,0 V8"/><path d="M-11,8 H11 L0,20 Z" class="full"/>',
    "signal ground": '<path d="M0,0 V8 M-12,8 H12 M-7,13 H7 M-3,18 H3"/>',
    "5V": '<path d="M0,0 V-8 M-7,-8 H7 L0,-18 Z"/>',
}
POTENTIOMETERS = {"theta_1": "chassis, 10 kΩ", "alpha": "arm, 10 kΩ"}


def _text(x: float, y: float, words: str, anchor: str = "start", kind: str = "") -> str:
    style = f' class="{kind}"' if kind else ""
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}"{style}>{words}</text>'


def _line(line: Line, kind: str, scale: int = 1, back: bool = False) -> str:
    at = " ".join(f"{(COLUMNS + 1 - x if back else x) * scale},{y * scale}" for x, y in line)
    return f'<polyline points="{at}" class="{kind}"/>'


def _svg(width: int, height: int, title: str, body: Iterable[str]) -> str:
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        'font-family="sans-serif" font-size="15">'
    )
    paper = f'<rect width="{width}" height="{height}" style="fill:#fff;stroke:none"/>'
    return "\n".join([head, f"<title>{title}</title>", STYLE, paper, *body, "</svg>", ""])


def diagram() -> Iterator[str]:
    """Yield the elements of the circuit diagram."""
    for line in DIAGRAM.lines:
        yield _line(line, "")
    corners = [end for line in DIAGRAM.lines for end in (line[0], line[-1])]
    for x, y in sorted(set(corners)):
        through = sum(
            (x, y) in points(line, 10) and (x, y) not in (line[0], line[-1])
            for line in DIAGRAM.lines
        )
        if 2 * through + corners.count((x, y)) + list(DIAGRAM.pins.values()).count((x, y)) > 2:
            yield f'<circle cx="{x}" cy="{y}" r="3.5" class="dot"/>'
    for name, places in DIAGRAM.labels.items():
        for x, y in places:
            yield f'<g transform="translate({x},{y})">{GROUNDS[name]}</g>'
    for x, y, width, height in BOXES.values():
        yield f'<rect x="{x}" y="{y}" width="{width}" height="{height}" class="box"/>'
    for name, kind, x, y in SYMBOLS:
        yield f'<g transform="translate({x},{y})">{SHAPES[kind]}</g>'
        across = kind in ("resistor across", "fuse", "opens", "closes", "link")
        value = (PARTS | POTENTIOMETERS).get(name, "").removesuffix(" 5 W")
        if across:
            up = -30 if name == "S1" else -14
            yield _text(x, y + up, name, "middle", "name") + _text(x, y + 26, value, "middle")
        else:
            is_left = kind in ("pnp", "diode", "reference")
            side, anchor = (-26, "end") if is_left else (20, "start")
            top = y - 26 if kind == "thyristor" else y - 2
            yield _text(x + side, top, name if name != "M" else "", anchor, "name")
            yield _text(x + side, top + 18, value, anchor)
    yield _text(50, 50, "supply", "middle", "name") + _text(50, 215, "5.0 V", "middle")
    yield _text(50, 235, "7 A", "middle") + _text(110, 450, "Arduino Uno", "middle", "name")
    yield _text(1260, 50, "U2: DRV8874 on its carrier", "middle", "name")
    yield _text(790, 54, "S1: emergency stop, opens", "middle")
    yield _text(340, 482, "S1: the same button, closes")
    for name, (x, y) in DIAGRAM.pins.items():
        part, pin = name.split(".")
        left, top, width, height = BOXES.get(part, (0, 0, 0, 0))
        if not width:
            continue
        pin = "GND" if pin == "GND2" else pin
        if y == top + height:
            yield f'<text transform="translate({x + 5},{y - 8}) rotate(-90)">{pin}</text>'
        elif x == left:
            yield _text(x + 8, y + 5, pin)
        else:
            yield _text(x - 8, y + 5, pin, "end")
    for n, words in enumerate(
        (
            "Full triangle: power ground. Three bars: signal ground.",
            "They meet in W1 alone: no motor current in the Uno's wires.",
            "Arrow: 5 V of the Uno, for the potentiometers alone.",
            "On the carrier VM, OUT1, IMODE, FAULT and CS stay open;",
            "on the Uno A5 does, which makes the board's names.",
            "Everything but supply, switch, motor, potentiometers",
            "and Uno is on the board of the next drawing.",
        )
    ):
        yield _text(800, 790 + 26 * n, words)


# Of each terminal block on the board: its title, pins, and side of the labels.
TERMINALS = {
    "J1 supply": ("supply.+", "supply.-"),
    "J2 S1 opens": ("S1.1", "S1.2"),
    "J3 motor": ("M.-", "M.+"),
    "J4 theta_1": ("theta_1.5V", "theta_1.W", "theta_1.GND"),
    "J5 alpha": ("alpha.5V", "alpha.W", "alpha.GND"),
    "J6 Uno": ("Uno.A1", "Uno.A0", "Uno.5V", "Uno.GND", "Uno.D9", "Uno.D7"),
}
# What a part covers, in rows and columns: left, top, right, bottom; and its label's place.
BODIES = {
    "F1": ((3.2, 2.9, 13.8, 5.1), (8.5, 4.2)),
    "D1": ((5.9, 15.2, 10.1, 16.5), (8.6, 18.4)),
    "Q1": ((11.9, 15.2, 16.1, 16.5), (13.4, 18.4)),
    "C1": ((31.5, 18.2, 32.5, 19.8), (32.7, 19.2)),
    "C3": ((60.5, 4.2, 61.5, 5.8), (61.4, 3.4)),
    "C4": ((20.5, 23.2, 21.5, 24.8), (20.3, 24.2)),
    "C5": ((36.5, 23.2, 37.5, 24.8), (36.3, 24.2)),
    "R7": ((40.1, 7.6, 43.9, 16.4), (42, 12)),
    "R8": ((45.1, 7.6, 48.9, 16.4), (47, 12)),
    "U2": ((53.4, 4.5, 59.6, 11.6), (56.5, 12.5)),
}
DOMES = {
    "U1": ("M25.4,16.5 H28.6 A1.6,1.6 0 0 1 25.4,16.5 Z", 27, 16.2),
    "Q2": ("M23.4,12.5 H26.6 A1.6,1.6 0 0 0 23.4,12.5 Z", 25, 10.7),
}
"""The flat side shows to the rows above at U1, to those below at Q2."""
HEAT_SINK = (3.3, 6.6, 19.3, 15.0)
PITCH = 22


def _kind(pins: frozenset[str]) -> str:
    if pins & {"supply.+", "F1.2", "S1.2"}:
        return "plus"
    if "supply.-" in pins:
        return "ground"
    return "out" if "M.+" in pins else "thin"


def _tracks(back: bool) -> Iterator[str]:
    for column in range(1, COLUMNS + 1):
        for row in range(1, ROWS + 1):
            yield f'<circle cx="{column * PITCH}" cy="{row * PITCH}" r="3" class="hole"/>'
    nets = drawn(BOARD)
    for line in BOARD.lines:
        touching = {pin for pin, at in BOARD.pins.items() if at in points(line, 1)}
        net = next((net for net in nets if touching & net), frozenset[str]())
        yield _line(line, _kind(net), PITCH, back)


def board(*, back: bool = False) -> Iterator[str]:
    """Yield the elements of the board, from the parts' side or, mirrored, from the tracks'."""
    yield f'<g transform="translate(30,{50})">'
    p = PITCH

    def at(x: float) -> float:
        return (COLUMNS + 1 - x if back else x) * p

    for column in (1, *range(5, COLUMNS + 1, 5)):
        yield _text(at(column), -2, str(column), "middle", "note")
    for row in (1, *range(5, ROWS + 1, 5)):
        yield _text(0, row * p + 5, str(row), "end", "note")
    width, height = (COLUMNS + 0.4) * p, (ROWS + 0.4) * p
    yield f'<rect x="{0.3 * p:g}" y="{0.3 * p:g}" width="{width:g}" height="{height:g}"/>'
    yield from _tracks(back)
    if not back:
        yield from _bodies()
    for name, (x, y) in BOARD.pins.items():
        kind = "open" if name in NOT_CONNECTED else "lead"
        yield f'<circle cx="{at(x)}" cy="{y * p}" r="4.5" class="{kind}"/>'
        if back and name not in NOT_CONNECTED:
            words = name.replace("GND2", "GND").replace(".-", ".−")
            turn = f"translate({at(x) + 5},{y * p - 6}) rotate(-40)"
            yield f'<text transform="{turn}" class="small">{words}</text>'
    for wire in BOARD.wires:
        for x, y in (wire[0], wire[-1]):
            yield f'<circle cx="{at(x)}" cy="{y * p}" r="4.5" style="fill:#1565c0;stroke:none"/>'
    yield "</g>"


def _bodies() -> Iterator[str]:
    p = PITCH

    def body(left: float, top: float, right: float, bottom: float, round_by: float = 3) -> str:
        return (
            f'<rect x="{left * p:g}" y="{top * p:g}" width="{(right - left) * p:g}" '
            f'height="{(bottom - top) * p:g}" rx="{round_by}" class="body"/>'
        )

    yield body(*HEAT_SINK)
    yield _text(11.3 * p, 9.5 * p, "heat sink for D1 and Q1, 7 K/W:", "middle")
    yield _text(11.3 * p, 10.5 * p, "both tabs are +, so it is +, too", "middle")
    for name, (box, (x, y)) in BODIES.items():
        yield body(*box)
        anchor = "start" if name in ("C1", "Q1") else "end" if name[0] in "CD" else "middle"
        yield _text(x * p, y * p, f"{name} {PARTS[name].removesuffix(' 5 W')}", anchor)
    for name, (dome, x, y) in DOMES.items():
        thin = 'class="body" style="stroke-width:0.06"'
        yield f'<g transform="scale({p})"><path d="{dome}" {thin}/></g>'
        yield _text(x * p, y * p, f"{name} {PARTS[name]}", "middle")
    yield f'<circle cx="{37 * p}" cy="{13 * p}" r="{2.5 * p}" class="body"/>'
    yield _text(37.3 * p, 17.2 * p, "C2 1000 µF")
    yield _text(37.5 * p, 11.6 * p, "+", "start", "name")
    for name in ("R7", "R8"):
        for pin, edge in (("1", 7.6), ("2", 16.4)):
            x, y = BOARD.pins[f"{name}.{pin}"]
            yield f'<path d="M{x * p},{y * p} V{edge * p:g}"/>'
        yield _text(x * p, 13 * p, "5 W", "middle")
    for name in (name for name in PARTS if name[0] == "R" and name not in BODIES):
        (x0, y0), (x1, y1) = BOARD.pins[f"{name}.1"], BOARD.pins[f"{name}.2"]
        yield _line(((x0, y0), (x1, y1)), "", p)
        x, y = (x0 + x1) / 2, (y0 + y1) / 2
        words = f'text-anchor="middle" font-size="11">{name} {PARTS[name]}</text>'
        if x0 == x1:
            yield body(x - 0.45, y - 1.35, x + 0.45, y + 1.35, 8)
            yield f'<text transform="translate({x * p + 4:g},{y * p:g}) rotate(-90)" {words}'
        else:
            yield body(x - 1.35, y - 0.45, x + 1.35, y + 0.45, 8)
            yield f'<text x="{x * p:g}" y="{y * p + 4:g}" {words}'
    x, y = BOARD.pins["W1.1"]
    yield f'<path d="M{x * p},{y * p} V{BOARD.pins["W1.2"][1] * p}" style="stroke-width:5"/>'
    yield _text((x - 0.3) * p, (y + 1.7) * p, "W1", "end", "name")
    for title, pins in TERMINALS.items():
        xs, ys = zip(*(BOARD.pins[pin] for pin in pins), strict=True)
        yield body(min(xs) - 1, min(ys) - 1.1, max(xs) + 1, max(ys) + 1.1)
        middle = (min(xs) + max(xs)) / 2 * p
        if ys[0] > 5:
            yield _text(middle, (ys[0] + 1.9) * p, title, "middle", "name")
        else:
            x, y = (max(xs) + 1.2, 2.4) if title.startswith("J2") else (0.8, 2.6)
            yield _text(x * p, y * p, title, "start", "name")
        for pin, x, y in zip(pins, xs, ys, strict=True):
            word = pin.split(".")[1].replace("-", "−")
            yield _text(x * p, (y - 0.35) * p, word, "middle", "name")
    for name in [n for n in BOARD.pins if n.startswith("U2.")]:
        x, y = BOARD.pins[name]
        word = name[3:].replace("GND2", "GND")
        beside, anchor = (0.4, "start") if x == 54 else (-0.4, "end")
        yield _text((x + beside) * p, y * p + 5, word, anchor, "small")
    for part in ("D1", "Q1", "Q2", "U1"):
        for name in [n for n in BOARD.pins if n.startswith(f"{part}.")]:
            x, y = BOARD.pins[name]
            below = -0.35 if part == "Q2" else 1.2
            yield _text(x * p, (y + below) * p, name.split(".")[1], "middle", "small")
    for wire in BOARD.wires:
        yield _line(wire, "wire", p) + _line(wire, "wire core", p)


def legend(back: bool) -> Iterator[str]:
    """Yield what the colours are."""
    side = "from the tracks' side" if back else "from the parts' side, tracks seen through"
    yield _text(30, 24, f"Board, {side}; columns and rows are 2.54 mm apart", kind="name")
    y = 50 + (ROWS + 1) * PITCH + 24
    kinds = (
        ("plus", "+: wire of 0.8 mm, tinned"),
        ("ground", "power ground: the same"),
        ("out", "to the motor: the same"),
        ("thin", "signals: wire of 0.5 mm"),
        ("wire core", "insulated, on the parts' side"),
    )
    for n, (kind, words) in enumerate(kinds):
        if not (back and "core" in kind):
            yield _line(((40 + 270 * n, y), (80 + 270 * n, y)), kind)
            yield _text(90 + 270 * n, y + 5, words)


def figures() -> dict[str, str]:
    """Return the text of each figure by its file's name."""
    width, height = COLUMNS * PITCH + 80, ROWS * PITCH + 120
    return {
        "wiring.svg": _svg(1560, 1000, "Circuit of the rig's electronics", diagram()),
        "board.svg": _svg(width, height, "Board, parts' side", [*legend(False), *board()]),
        "board-back.svg": _svg(
            width, height, "Board, tracks' side", [*legend(True), *board(back=True)]
        ),
    }


def main() -> None:
    """Draw all of them."""
    for name, text in figures().items():
        (FOLDER / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
