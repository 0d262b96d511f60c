"""Output of every command, word for word: a file for each in `said/`.

A new case is a line `$ armrig …` in one of the files. `make stored` writes the files again, with
the present output; read the difference by `git diff`.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from difflib import unified_diff
from pathlib import Path, PurePosixPath
from typing import Any

import armrig
import numpy as np
import pytest
from armrig.cli import app as armrig_app
from armrig_core.access.endpoint import endpoint
from armrig_core.commands.commands import RunRequest
from armrig_core.rig.calibration_file import toml_of
from armrig_daemon.command_line import app as armrigd_app
from armrig_daemon.config import ArmSettings, Config
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.service.virtual_service import LEASE, VirtualService
from mcap.writer import CompressionType
from typer.main import get_command

from tests.clients.calibration_rig import recording_of
from tests.clients.fake_daemon import FakeDaemon
from tests.clients.made_recordings import manifest, of_the_arm, recorded, turning, written
from tests.clients.made_turns import made_turns, still
from tests.clients.odd_recording import FORWARD, ODD, odd_recording, odd_turns
from tests.clients.said import said_again
from tests.sampling import without_slow

SAID = Path(__file__).parent / "said"
OF_A_HOST = {"lab", "doctor"}
AGAIN = "If this is what the command is to say: make stored"
SLOW = {"hints", "report", "batch", "host", "identify_noise", "several"}
FILES = sorted(SAID.rglob("*.txt"))
DATA = Path(__file__).parents[2] / "data" / "0.2.0"
WHOLE = re.compile(r"--(verbose|json|help)|-v\b|^armrigd?$")
"""Commands that print all that they know."""
SCREEN_LINES = 23


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give the folder that each file's commands begin in: what an emulated rig recorded."""
    folder = tmp_path_factory.mktemp("made")
    own = folder / "recordings"
    own.mkdir()
    rig = VirtualService(Config(), own, seed=1)
    chassis = Config(arm=ArmSettings(removed=True), emulator=EmulatorSettings(arm_removed=True))
    bare = VirtualService(chassis, own, seed=100)
    first = _recorded(rig, armrig.step(200, at=50), "step-first")
    monday = _recorded(rig, armrig.telegraph(1000, 0.05, seed=1), "blackbox-monday")
    of = {"validation_of": monday.stem.rpartition("-")[2]}
    _recorded(rig, armrig.telegraph(800, 0.05, seed=2), "blackbox-validation-monday", of)
    _recorded(bare, armrig.telegraph(800, 0.05, seed=3), "greybox-chassis")
    data = armrig.load(monday).dataset()
    armrig.oe(data, nb=4, nf=4, integrator=True).save(folder / "oe.json")
    armrig.arx(data, na=4, nb=4).save(folder / "arx.json")
    for released, name in {"n4sid.json": "alpha.json", "exchange.mcap": "exchange.mcap"}.items():
        shutil.copy(DATA / released, folder / name)
    shutil.copy(first, folder / "step.mcap")
    whole = {"compression": CompressionType.NONE, "flush_every": 50, "outcome": None}
    samples = turning([30_000 + 40 * (k % 50) for k in range(200)])
    torn = recorded(samples, manifest=manifest(k_first=0, samples=400), **whole)[:-5_000]
    written(folder, torn, "cut.mcap")
    for name, part in {"left": torn, "other": torn[:-9_000], "empty": b""}.items():
        written(folder, part, f"{name}.mcap.active")
    u = armrig.telegraph(600, 0.05, seed=4)
    written(folder, of_the_arm(u, missing=slice(300, 305)), "gap.mcap")
    odd = armrig.load(written(folder, odd_recording(), "odd.mcap"))
    armrig.arx(odd.dataset("alpha"), na=3, nb=2).save(folder / "odd.json")
    (folder / "forward.toml").write_text(toml_of(FORWARD))
    written(folder, recording_of(still(), "calibrate-rest"), "rest.mcap")
    written(folder, recording_of(made_turns(noise=32.0), "calibrate-turns"), "turns.mcap")
    (folder / "two.csv").write_text(_two_outputs())
    nine = {"rig": "9", "device": {"adc_bits": 12, "pwm_bits": 8, "uid": "beef"}}
    for name, readings in zip(("rest", "turns"), odd_turns(), strict=True):
        turned = recording_of(readings, f"calibrate-{name}", ODD, **nine)
        written(folder, turned, f"odd-{name}.mcap")
    rows = zip(data.t, data.u, data.y, strict=True)
    text = "\n".join(["t,u,y", *(f"{t:.2f},{u:.4f},{y:.6f}" for t, u, y in rows)])
    (folder / "data.csv").write_text(text)
    (folder / "odd.csv").write_text(_odd_table())
    (folder / "flat.csv").write_text("u,y\n" + "1,2\n" * 100)
    (folder / "words.txt").write_text("no recording\n")
    return folder


def _odd_table() -> str:
    """Return 300 rows from 5 s on, 0.1 s apart: y(t) = 0.8 y(t-1) - 3 u(t-2) about a level of -40.

    The columns have another order; three values of y are wrong, and four are missing.
    """
    rng = np.random.default_rng(11)
    u, y, shown = rng.choice([-1.0, 0.5, 2.0], 300), np.zeros(300), list[str]()
    for k in range(2, 300):
        y[k] = 0.8 * y[k - 1] - 3 * u[k - 2]
    for k, x in enumerate(
        y - 40 + 0.2 * rng.standard_normal(300) + 40 * np.isin(y, y[[80, 140, 260]])
    ):
        shown.append("" if k in (30, 31, 32, 200) else f"{x:.4f}")
    rows = (f"{one},{5 + k / 10:.1f},{u[k]}" for k, one in enumerate(shown))
    return "\n".join(["rate,t_s,u_v", *rows])


def _two_outputs() -> str:
    """Return 200 rows of two inputs, their copy u2, a constant w, and two outputs."""
    rng = np.random.default_rng(12)
    u, y = rng.choice([-1.0, 1.0], (200, 2)), np.zeros((200, 2))
    for k in range(1, 200):
        y[k] = [0.8, 0.5] * y[k - 1] + [[1.0, 0.3], [0.0, 2.0]] @ u[k - 1]
    y += 0.1 * rng.standard_normal(y.shape)
    lines = [f"{a:g},{b:g},{p:.4f},{q:.4f},{a:g},1" for (a, b), (p, q) in zip(u, y, strict=True)]
    return "\n".join(["u,v,y,z,u2,w", *lines])


def _recorded(
    rig: VirtualService, u: Any, experiment: str, details: dict[str, Any] | None = None
) -> Path:
    request = RunRequest(
        lease=LEASE, n=0, u=u.tolist(), experiment=experiment, details=details or {}
    )
    return rig.record(request)


@pytest.fixture
def folder(
    made: Path, tmp_path: Path, typed: Callable[[None], None], monkeypatch: pytest.MonkeyPatch
) -> Iterator[Path]:
    """Change into a copy of the folder, without files of this machine."""
    here = tmp_path / "here"
    shutil.copytree(made, here)
    (here / ".home").mkdir()
    monkeypatch.chdir(here)
    typed(None)
    # Whether this machine has a programmer is no command's doing; none of them starts it.
    programmer = made / "programs" / "avrdude"
    programmer.parent.mkdir(exist_ok=True)
    programmer.write_text("#!/bin/false\n")
    programmer.chmod(0o755)
    monkeypatch.setenv("PATH", f"{programmer.parent}:{os.environ['PATH']}")
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", _write_words)
    monkeypatch.setattr("typst.Compiler", _Compiler)
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setenv("TZ", "UTC")
    monkeypatch.setenv("ARMRIG_RECORDING_DIRECTORY", "recordings")
    for name in ("HOME", "XDG_CONFIG_HOME", "XDG_CACHE_HOME", "XDG_DATA_HOME"):
        monkeypatch.setenv(name, str(here / ".home"))
    # A path of pytest's may be too long for a socket.
    with tempfile.TemporaryDirectory(prefix="armrig-") as sockets:
        monkeypatch.setenv("XDG_RUNTIME_DIR", sockets)
        (Path(sockets) / "armrig").mkdir(mode=0o700)
        yield here


def _write_words(figure: Any, path: Any, **_: Any) -> None:
    """Write the words of a figure instead of a picture, which is quick to make and to read."""
    lines = []
    for ax in figure.axes:
        legend = ax.get_legend()
        named = [text.get_text() for text in legend.get_texts()] if legend else []
        named += [text.get_text() for text in ax.texts]
        size = f"{len(ax.lines)} lines"
        if not ax.get_ylabel().startswith("Im"):  # regions that are sampled have any number
            size += f" of {sum(len(line.get_xdata()) for line in ax.lines)} points"
        size += f", {len(ax.collections)} areas"
        lines += [f"{ax.get_ylabel()!r} over {ax.get_xlabel()!r}: {ax.get_title()!r}, {size}"]
        lines += [f"  {' | '.join(named)}"] if named else []
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")


def _texts(value: Any) -> Any:
    """Return a value without the parts that contain no text."""
    if isinstance(value, dict):
        return {key: kept for key, item in value.items() if (kept := _texts(item))}
    if isinstance(value, list):
        return value if all(isinstance(x, str) for x in value) else [*map(_texts, value)]
    return value if isinstance(value, str) else ""


class _Compiler:
    """Gives the texts of a report instead of typst's PDF."""

    def __init__(self, template: str, *, root: str, **_: Any) -> None:
        self.values = Path(root) / "data.json"

    def compile(self) -> bytes:
        return json.dumps(_texts(json.loads(self.values.read_text())), ensure_ascii=False).encode()

    def query(self, *_: Any, **__: Any) -> str:
        return '[["the end", 1.0]]'


@pytest.fixture
def rig(folder: Path) -> Iterator[None]:
    """Give a daemon that only answers, at its usual place; its recording is an older one."""
    sockets = PurePosixPath(os.environ["XDG_RUNTIME_DIR"]) / "armrig"
    with FakeDaemon(endpoint("1", sockets)) as daemon:
        daemon.recording = str(next((folder / "recordings").glob("*-blackbox-monday-*")))
        yield


@pytest.mark.parametrize(
    "file", without_slow(FILES, lambda file: file.stem in SLOW), ids=lambda file: file.stem
)
def test_a_command_prints_the_stored_output(
    file: Path, folder: Path, request: pytest.FixtureRequest
) -> None:
    stored = file.read_text(encoding="utf-8")
    if file.stem == "rig":
        request.getfixturevalue("rig")

    found = said_again(stored, folder)

    if os.environ.get("WRITE_STORED"):
        file.write_text(found, encoding="utf-8")
        return
    differs = unified_diff(
        stored.splitlines(), found.splitlines(), f"{file.name}, stored", "now", n=2, lineterm=""
    )
    if lines := list(differs):
        pytest.fail("\n".join([*lines, "", AGAIN]), pytrace=False)


def test_every_command_has_a_stored_output() -> None:
    text = "".join(file.read_text(encoding="utf-8") for file in FILES)

    for program, app in (("armrig", armrig_app()), ("armrigd", armrigd_app)):
        for name in get_command(app).commands.keys() - OF_A_HOST:
            assert f"$ {program} {name}" in text


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_an_output_without_verbose_fits_a_screen(file: Path) -> None:
    answers = re.findall(r"^\$ (.*)\n((?:  .*\n)*)", file.read_text(encoding="utf-8"), re.MULTILINE)
    long = {line: text.count("\n") for line, text in answers if not WHOLE.search(line)}

    assert {line: n for line, n in long.items() if n > SCREEN_LINES} == {}
