"""The layouts for Foxglove and PlotJuggler name the content of a recording exactly."""

from __future__ import annotations

import subprocess
from functools import partial
from math import pi
from pathlib import Path

import numpy as np
import pytest
from armrig.physics.files.poses import write_transforms
from armrig.recordings.files.loading import load
from armrig_core.commands.commands import RunRequest
from armrig_core.rig.description import builtin
from armrig_daemon.config import Config
from armrig_daemon.emulator.device import Device
from armrig_daemon.service.virtual_service import LEASE, VirtualService

from tests.layouts import Kinds, foxglove_paths, kinds_in_file, plotjuggler_curves, snippets
from tests.tools import require

RATE = "rate of θ₁"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording of the daemon's, made in virtual time."""
    service = VirtualService(Config(), tmp_path_factory.mktemp("run"), seed=1)
    return service.record(RunRequest(lease=LEASE, n=0, u=[1.0] * 10, experiment="step"))


@pytest.fixture(scope="module")
def there(recorded: Path) -> Kinds:
    """Return topics and fields of the recording."""
    return kinds_in_file(recorded)


def test_foxglove_s_layout_names_what_is_in_a_recording_and_its_transforms(
    recorded: Path, there: Kinds
) -> None:
    pytest.importorskip("foxglove", reason="no foxglove-sdk")
    frames = recorded.with_name("frames.mcap")
    write_transforms(load(recorded), frames)
    named = foxglove_paths()

    assert named.items() <= (there | kinds_in_file(frames)).items()
    streams = {path.split("/")[-1].partition(".")[0] for path in named}
    assert streams == {"sample", "state", "event", "transforms"}


def test_plotjuggler_s_layout_names_what_is_in_a_recording(there: Kinds) -> None:
    curves, sources = plotjuggler_curves()
    named = {path.replace(".", "/"): kind for path, kind in there.items()}

    assert set(snippets()) <= curves
    assert {named.get(curve) for curve in curves - set(snippets())} == {"number"}
    assert {named.get(source) for source in sources} == {"number", "text"}


def test_plotjuggler_s_rate_ignores_wraps_and_averages_converter_steps() -> None:
    require("lua5.4")
    t, step = 1e9 + np.arange(2000) * 1e-3, 2 * pi / 1024
    theta_1 = np.round(((9.0 * (t - t[0])) % (2 * pi)) / step) * step
    rate = snippets()[RATE]
    rows = "".join(
        f"put({at!r}, {y!r})\n" for at, y in zip(t.tolist(), theta_1.tolist(), strict=True)
    )
    program = f"""{rate.findtext("global")}
        function calc(time, value) {rate.findtext("function")} end
        function put(t, y) local at, rate = calc(t, y); if rate then print(rate) end end
        """

    said = subprocess.run(
        ["lua5.4", "-"], input=program + rows, capture_output=True, text=True, check=True
    )

    rates = [float(line) for line in said.stdout.split()]
    assert len(rates) == pytest.approx(20, abs=1)
    assert rates == pytest.approx([9.0] * len(rates), abs=step / 0.1)


def test_the_layouts_of_a_described_rig_name_what_is_in_its_recording(tmp_path: Path) -> None:
    """A heater does not turn, so nothing shows a rate or a pose."""
    described = builtin("heater")
    service = VirtualService(
        Config(),
        tmp_path,
        seed=1,
        switch_on=partial(Device, description=described),
        description=described,
    )
    there = kinds_in_file(
        service.record(RunRequest(lease=LEASE, n=0, u=[1.0] * 10, experiment="step"))
    )
    curves, sources = plotjuggler_curves(described)

    named = foxglove_paths(described)
    assert named.items() <= there.items()
    assert {path for path in named if ".T" in path} == {f"/rig/1/sample.T{n}_degC" for n in (1, 2)}
    assert {f"/rig/1/sample/T{n}_degC" for n in (1, 2)} < curves
    assert not [source for source in sources if "sample" in source]
