"""Drawn rigs from their description to the report, and a judge that knows each rig's truth.

`python -m tests.drawn_chains --seed 1 --count 100` prints the rigs judged wrong, and counts. Drawn
are time constants from 5 ms to 20 min, dead time, gain, limits, noise, one or two outputs, and a
static curve of the input in a file of own equations. Each rig goes through `rigs check`, the
experiments that its description suggests, `sampling`, `hints`, `check`, and `identify` with
validation, in virtual time. The report is typeset for each tenth rig.
"""

from __future__ import annotations

import argparse
import io
import json
import math
import tempfile
import time
from collections import Counter
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import armrig
import numpy as np
from armrig.cli import main as command
from armrig.excitation.demonstration import experiments
from armrig.excitation.pace import Pace, pace_of
from armrig_core.commands.commands import RunRequest
from armrig_core.errors import InputError, OperationError
from armrig_core.rig.description import Description, read_description
from armrig_daemon.config import Config, TimingTable
from armrig_daemon.emulator.device import Device
from armrig_daemon.service.virtual_service import LEASE, VirtualService
from numpy.random import Generator

from tests.drawn_rigs import Verdict

COUNTS = 65_536


@dataclass(frozen=True, slots=True, kw_only=True)
class DrawnChain:
    """A rig with a first-order response of each output, and its true parameters."""

    taus: tuple[float, ...]
    """Time constant of each output, in s."""
    gains: tuple[float, ...]
    """Change of each output by 1 V, in its unit; at small voltages, with a static curve."""
    dead_s: float
    curve: float
    """Share of the gain that is lost at 5 V; 0 is a linear rig."""
    high: float
    """Limit of the first output as a share of its change by 5 V; more than 1 is no limit."""
    noise: float
    """Standard deviation of the noise, in steps of the converter."""
    unit: str
    per_volt: float
    seed: int

    @property
    def per_count(self) -> float:
        """Value of a count: the largest change is half of the converter's range."""
        return max(map(abs, self.gains)) * 5 / (0.5 * COUNTS)

    def text(self) -> str:
        """Return the description."""
        lines = ['[rig]\nname = "drawn"\n[input]\nname = "power"', f'unit = "{self.unit}"']
        lines += [f"per_volt = {self.per_volt!r}"]
        for name, gain in zip("pq", self.gains, strict=False):
            zero = 0.25 * COUNTS if gain > 0 else 0.75 * COUNTS
            lines += [f'[outputs.{name}]\nunit = "degC"\nzero_counts = {zero}']
            lines += [f"per_count = {self.per_count!r}"]
            if name == "p" and self.high < 1:
                side = "high" if gain > 0 else "low"
                lines += [f"{side} = {5 * gain * self.high!r}"]
        noise = [self.noise * self.per_count * 64] * len(self.taus)
        lines += ["[model]", f"noise = {noise}", f"delay_s = {self.dead_s!r}"]
        if self.curve:
            return "\n".join([*lines, 'file = "drawn.py"']) + "\n"
        n = len(self.taus)
        A = [[-1 / self.taus[i] if i == j else 0.0 for j in range(n)] for i in range(n)]
        B = [[gain / tau] for gain, tau in zip(self.gains, self.taus, strict=True)]
        C = [[float(i == j) for j in range(n)] for i in range(n)]
        return "\n".join([*lines, f"A = {A}\nB = {B}\nC = {C}"]) + "\n"

    def equations(self) -> str:
        """Return the file of own equations."""
        v = f"u[0] * (1 - {self.curve / 10!r} * u[0])"
        parts = zip(range(len(self.taus)), self.gains, self.taus, strict=True)
        derivatives = ", ".join(f"({gain!r} * {v} - x[{i}]) / {tau!r}" for i, gain, tau in parts)
        n = len(self.taus)
        return (
            f"import armrig\nmodel = armrig.Ode(lambda t, x, u, p: [{derivatives}], "
            f"output=lambda t, x, u, p: [x[i] for i in range({n})], "
            f"states={[*map(str, range(n))]}, parameters={{}})\n"
        )


def drawn_chain(rng: Generator) -> DrawnChain:
    """Return a rig."""
    # One in ten is slow, because each second of virtual time takes 3 ms of the processor.
    slow = 20.0 if rng.random() < 0.1 else 1.0
    tau = slow * float(np.exp(rng.uniform(np.log(0.005), np.log(60.0))))
    n = int(rng.integers(1, 3))
    unit, per_volt = [("%", 20.0), ("V", 2.0), ("A", 0.35), ("rpm", 840.0)][rng.integers(4)]
    taus = tuple(float(tau * rng.uniform(0.5, 1.0)) for _ in range(n))
    return DrawnChain(
        taus=taus,
        gains=tuple(
            float(rng.choice([1, -1]) * 10 ** rng.uniform(-1, 2) * rng.uniform(0.5, 1))
            if i == 0
            else 0.0
            for i in range(n)
        ),
        dead_s=float(rng.choice([0.0, 0.0, 0.1, 0.5]) * tau),
        curve=float(rng.choice([0.0, 0.0, 0.0, 0.0, 0.6])),
        high=float(rng.choice([0.5, 0.8, 2.0, 2.0])),
        noise=float(rng.choice([0.3, 1.0, 3.0])),
        unit=unit,
        per_volt=per_volt,
        seed=int(rng.integers(1 << 30)),
    )


def judged(rig: DrawnChain, folder: Path, *, typesets: bool) -> Verdict:
    """Take a rig through the chain; compare with its truth."""
    found = Verdict()
    path = folder / "drawn.toml"
    path.write_text(rig.text())
    (folder / "drawn.py").write_text(rig.equations())
    described = read_description(path)
    with redirect_stderr(io.StringIO()):
        try:
            pace = pace_of(described)
        except InputError as err:
            found.outcome = f"no experiment: {str(err)[:40]}"
            return found
        files = recorded(rig, described, pace, folder, found)
    if len(files) < 3:
        return found
    found.outcome = "through the chain"
    step, first, second = map(str, files)
    sampled = printed(["sampling", step, "--signal", "p"], found)
    hinted = printed(["hints", first, "--signal", "p"], found)
    checked = printed(["check", first, "--signal", "p"], found)
    if not (sampled and hinted and checked):
        return found
    orders = [f"--{name}={value}" for name, value in hinted["orders"].items()]
    arguments = ["identify", first, "--structure", hinted["structure"], *orders, "--signal", "p"]
    if hinted["integrator"]:
        found.wrong.append("a rig that settles is taken as integrating")
        return found
    fit = printed([*arguments, "--offset", "--validate", second], found)
    if fit:
        _judge_model(rig, pace, fit, found)
    _judge_sentences(rig, pace, checked, found)
    if typesets:
        printed(["report", first, second, "-o", str(folder / "r.pdf")], found, json_out=False)
    return found


def recorded(
    rig: DrawnChain, described: Description, pace: Pace, folder: Path, found: Verdict
) -> list[Path]:
    """Play the suggested experiments, each from rest."""
    files: list[Path] = []
    config = Config(timing=TimingTable(Ts=pace.Ts / pace.every))
    for i, one in enumerate(experiments(pace, 1)):
        service = VirtualService(
            config, folder, seed=rig.seed % 1000 + i, description=described,
            switch_on=partial(Device, description=described),
        )  # fmt: skip
        request = one.of_the_device()
        try:
            files.append(service.record(RunRequest(lease=LEASE, n=1, **request)))
        except (OperationError, InputError) as err:
            found.outcome = "an experiment was refused or stopped"
            found.wrong.append(f"{one.name}: {err}")
            return files
        recording = armrig.load(files[-1])
        if rig.high < 1 and np.nanmax(np.abs(recording["p"])) > abs(5 * rig.gains[0]) * rig.high:
            found.wrong.append(f"p reaches {np.nanmax(np.abs(recording['p'])):.4g}, a limit")
    return files


def printed(arguments: list[str], found: Verdict, *, json_out: bool = True) -> dict[str, Any]:
    """Run a command; return its JSON. A refusal is a doubt, and an internal error is wrong."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = command([*arguments, "--json"] if json_out else arguments)
    said = err.getvalue()
    if "internal error" in said or "Traceback" in said:
        found.wrong.append(f"{arguments[0]}: {said[:300]}")
    if code != 0:
        found.outcome = f"{arguments[0]}: {said.strip().splitlines()[-1][:70]}"
        return {}
    return dict(json.loads(out.getvalue())) if json_out else {"said": out.getvalue()}


def _judge_model(rig: DrawnChain, pace: Pace, fit: dict[str, Any], found: Verdict) -> None:
    """Compare the gain, and the time to 63 % of a step, with the truth, if the model is trusted."""
    doubts = [*fit["warnings"], *fit.get("validation", {}).get("warnings", [])]
    low, high = (rig.gains[0] * (1 - rig.curve / 5 * u) for u in (pace.low, pace.high))
    middle = rig.gains[0] * (1 - rig.curve / 10 * (pace.low + pace.high))
    figures = fit["answers"]["figures"]
    # The time to 63 % begins when the model begins to move.
    moves_s = (fit["orders"]["nk"] - 1) * pace.Ts
    truth = {"gain": middle / rig.per_volt, "rise_time": rig.taus[0] + rig.dead_s - moves_s}
    for name, true in truth.items():
        figure = figures[name]
        if figure["value"] is None or (rig.curve and name != "gain"):
            continue
        std = (figure["high"] - figure["low"]) / 3.92
        allowed = 4 * std + 0.02 * abs(true)
        if name == "rise_time":
            allowed += pace.Ts
        if rig.curve:
            allowed += abs(low - high) / rig.per_volt
        if abs(figure["value"] - true) > allowed and not doubts:
            found.wrong.append(
                f"{name} {figure['value']:.4g} ± {std:.2g} in place of {true:.4g}, without a doubt"
            )


def _judge_sentences(rig: DrawnChain, pace: Pace, checked: dict[str, Any], found: Verdict) -> None:
    """Count sure sentences that are false: feedback, a dead time, a nonlinearity."""
    loop, delay, line = (checked[name] for name in ("open_loop", "delay", "linearity"))
    if loop.get("feedback"):
        found.doubts.append(f"FEEDBACK, p = {loop['p_value']:.2g}")
    samples = rig.dead_s / pace.Ts
    least, most = delay.get("interval", (0, math.inf))
    if not least - 1.01 <= samples + 1 <= most + 1.01:
        found.doubts.append(f"nk in {least} … {most} for {samples:.2f} samples of dead time")
    if not rig.curve and line.get("linear") is False:
        found.doubts.append(f"NONLINEAR, p = {line['p']:.2g}")


def run(seed: int, i: int) -> tuple[DrawnChain, Verdict]:
    """Draw and judge case i of a seed."""
    rig = drawn_chain(np.random.default_rng([seed, i]))
    with tempfile.TemporaryDirectory() as folder:
        return rig, judged(rig, Path(folder), typesets=i % 10 == 0)


def main() -> None:
    """Print the wrong cases, the outcomes and the processor time."""
    parser = argparse.ArgumentParser(prog="python -m tests.drawn_chains", description=__doc__)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--count", type=int, default=100)
    asked = parser.parse_args()
    outcomes: Counter[str] = Counter()
    wrong, false, longest = 0, 0, 0.0
    for i in range(asked.count):
        begun = time.process_time()
        rig, found = run(asked.seed, i)
        outcomes[found.outcome] += 1
        wrong += bool(found.wrong)
        false += bool(found.doubts)
        for text in (*found.wrong, *(f"at its level: {t}" for t in found.doubts)):
            print(f"case {i}: {text}\n  {rig}", flush=True)
        longest = max(longest, time.process_time() - begun)
    print(f"{wrong} of {asked.count} wrong, {false} with a false sentence; {dict(outcomes)}")
    print(f"{time.process_time():.0f} s; longest {longest:.0f} s")


if __name__ == "__main__":
    main()
