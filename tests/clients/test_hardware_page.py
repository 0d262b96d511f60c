"""docs/hardware.md: its rig for 20 €, on an emulated board, gives what the page says."""

from __future__ import annotations

import re
from pathlib import Path

import armrig
import numpy as np
import pages
import rc_rig
from armrig_daemon.config import load

TEXT = (pages.DOCS / "hardware.md").read_text(encoding="utf-8")


def test_the_rig_for_20_euros_has_the_poles_of_its_circuit(tmp_path: Path) -> None:
    """With the page's configuration, from a telegraph of 30 s; the page prints the same poles."""
    found = re.search(r"```toml\n(.*?)```", TEXT, re.DOTALL)
    assert found is not None
    config = tmp_path / "rc.toml"
    config.write_text(found[1], encoding="utf-8")

    _, telegraph, _ = rc_rig.record_all(tmp_path, load([config], {}, {}))
    data = armrig.load(telegraph).dataset("alpha")
    fit = armrig.oe(armrig.detrend(data), nb=2, nf=2, nk=1)

    poles = np.sort(np.roots(fit.F))
    printed = re.search(r"poles  ([\d.]+) ± \S+, ([\d.]+) ±", TEXT)
    assert printed is not None
    assert not armrig.structure_hints(armrig.load(telegraph).dataset("theta_1")).integrator
    np.testing.assert_allclose(np.log(poles) / 0.01, [-15.0, -8.0], rtol=0.01)
    np.testing.assert_allclose(poles, [float(printed[2]), float(printed[1])], atol=2e-3)
