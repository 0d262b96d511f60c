"""Draws the figures of docs/handout.md beside itself, from an emulated rig in virtual time."""

from __future__ import annotations

import importlib.util
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import armrig
from armrig_core.rig.arm import ArmParameters

FOLDER = Path(__file__).parent


def experiments() -> Any:
    """Return the script that records experiments."""
    found = importlib.util.spec_from_file_location("experiments", FOLDER / "experiments.py")
    if found is None or found.loader is None:
        raise FileNotFoundError(
            f"{FOLDER / 'experiments.py'} is not there; it records what this page shows"
        )
    script = importlib.util.module_from_spec(found)
    found.loader.exec_module(script)
    return script


def record_all(folder: Path) -> None:
    """Record what the page speaks of, under the names that it gives."""
    record = experiments().record
    record(folder / "first.mcap", armrig.step(2500, at=250), 0.002, "step")
    for seed, name in ((1, "estimation"), (2, "validation")):
        u = armrig.telegraph(3000, 0.05, seed=seed)
        record(folder / f"{name}.mcap", u, 0.01, "blackbox", seed)
    u = armrig.telegraph(4000, 0.05, seed=3)
    record(folder / "chassis.mcap", u, 0.01, "greybox", 3, arm_removed=True)


def main() -> None:
    """Draw all of them."""
    from armrig.physics.figures import plot_physical_step, plot_rig, plot_sensitivities
    from armrig.plots import plot_bode

    p = ArmParameters()
    cases = {
        "handout": p,
        "$J_1$ doubled": replace(p, J_1=2 * p.J_1),
        "$K_{lin}$ doubled": replace(p, K_lin=2 * p.K_lin),
    }
    draw = experiments().draw
    draw("handout-structure.svg", (6.3, 3.0), lambda ax: plot_rig(ax=ax))
    draw(
        "handout-step.svg",
        (11, 3.6),
        lambda ax: plot_physical_step(cases, ax=ax),
        lambda ax: plot_sensitivities(p, ax=ax),
    )
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        record_all(folder)
        estimation, validation, chassis = (
            armrig.load(folder / f"{name}.mcap").dataset()
            for name in ("estimation", "validation", "chassis")
        )
    fit = armrig.oe(estimation, nb=4, nf=4, integrator=True)
    physics = armrig.physics.physical_model(ArmParameters(), validation)
    names = ("OE", "physics")
    draw(
        "handout-compare.svg",
        (11, 4.6),
        lambda ax: armrig.compare(validation, fit, physics, labels=names).plot(ax=ax),
        lambda ax: plot_bode(fit, physics, labels=names, ax=ax),
    )
    loop, late = armrig.open_loop(estimation), armrig.delay(estimation)
    draw(
        "handout-checks.svg",
        (11, 4.2),
        lambda ax: loop.plot(ax=ax),
        lambda ax: late.plot(ax=ax),
    )
    study = armrig.split_study(chassis)
    draw("handout-split.svg", (6, 4.6), lambda ax: study.plot(ax=ax))


if __name__ == "__main__":
    main()
