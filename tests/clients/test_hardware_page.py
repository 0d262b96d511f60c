"""docs/hardware.md: drawings of one netlist, computed tables, and the rig for 20 €."""

from __future__ import annotations

import re
from pathlib import Path

import armrig
import numpy as np
import pytest
from armrig_core.rig.description import Description

from tests.clients import pages
from tests.clients.described_rig import record_all

TEXT = (pages.DOCS / "hardware.md").read_text(encoding="utf-8")
WIRING = pages.script("wiring.py")
SUPPLY = pages.script("motor_supply.py")
CIRCUIT = """
[model]
A = [[-13.0, 1.0], [10.0, -10.0]]
B = [[10.0], [0.0]]
C = [[1.0, 0.0], [0.0, 1.0]]
offset = [0.4166667, 0.4166667]
"""


def test_the_circuit_diagram_connects_the_netlist() -> None:
    assert WIRING.drawn(WIRING.DIAGRAM) == WIRING.netlist()


def test_the_board_connects_the_netlist() -> None:
    assert WIRING.drawn(WIRING.BOARD) == WIRING.netlist(WIRING.OFF_BOARD)


def test_each_hole_of_the_board_takes_one_lead() -> None:
    leads = [*WIRING.BOARD.pins.values()]
    leads += [end for wire in WIRING.BOARD.wires for end in (wire[0], wire[-1])]

    assert len(set(leads)) == len(leads)
    assert all(1 <= x <= WIRING.COLUMNS and 1 <= y <= WIRING.ROWS for x, y in leads)
    assert {pin.split(".")[0] for pin in WIRING.BOARD.pins} >= set(WIRING.PARTS)


def test_the_figures_of_the_page_are_those_of_the_script() -> None:
    """After a change, run docs/figures/wiring.py."""
    shown = set(re.findall(r"\]\(figures/(.+?)\)", TEXT))
    stored = {n: (pages.DOCS / "figures" / n).read_text(encoding="utf-8") for n in shown}

    assert stored == WIRING.figures()


@pytest.mark.parametrize("name", SUPPLY.TABLES)
def test_the_tables_of_the_page_are_computed(name: str) -> None:
    """After a change, run docs/figures/motor_supply.py."""
    assert SUPPLY.table(name) in TEXT


def test_the_threshold_of_the_page_is_computed() -> None:
    least, nominal, largest = SUPPLY.trip_voltages()

    assert f"Above {nominal:.2f} V ({least:.2f} to {largest:.2f} V" in TEXT
    assert f"with {SUPPLY.gate_current() * 1e3:.0f} mA into a gate" in TEXT


def test_the_parts_list_has_every_value_of_the_drawing() -> None:
    section = TEXT.split("## Parts\n")[1].split("\n## ")[0]

    assert {v for v in WIRING.PARTS.values() if v.removesuffix(" 5 W") not in section} == set()


@pytest.mark.exhaustive
def test_the_rig_for_20_euros_has_the_poles_of_its_circuit(tmp_path: Path) -> None:
    """With the page's configuration, from a telegraph of 30 s; the page prints the same poles."""
    found = re.search(r"```toml\n(\[rig\].*?)```", TEXT, re.DOTALL)
    assert found is not None
    described, plant = (Description.of((found[1] + more).encode()) for more in ("", CIRCUIT))

    lengths = {"first": (10.0, 0.002), "random": (30.0, 0.01)}
    _, telegraph, _ = record_all(tmp_path, described, "rc", plant=plant, **lengths)
    data = armrig.load(telegraph).dataset("v2")
    fit = armrig.oe(armrig.detrend(data), nb=2, nf=2, nk=1)

    poles = np.sort(np.roots(fit.F))
    printed = re.search(r"poles  ([\d.]+) ± \S+, ([\d.]+) ±", TEXT)
    assert printed is not None
    assert not armrig.structure_hints(armrig.load(telegraph).dataset("v1")).integrator
    np.testing.assert_allclose(np.log(poles) / 0.01, [-15.0, -8.0], rtol=0.01)
    np.testing.assert_allclose(poles, [float(printed[2]), float(printed[1])], atol=2e-3)
