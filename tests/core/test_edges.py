"""Each module of daemon and clients is pure by contract, or an edge that is named here."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EDGES = {
    "armrig": {
        "bench",
        "cli",
        "collection",
        "container",
        "demo",
        "doctor",
        "estimating",
        "listening",
        "model_file",
        "plots",
        "progress",
        "recording",
        "replay",
        "report",
        "report_figures",
        "rig",
        "sample_rows",
        "session",
    },
    "armrig_daemon": {
        "compact",
        "config",
        "emulator",
        "link",
        "loop_child",
        "loop_process",
        "pressure",
        "publish",
        "realtime",
        "record",
        "runs",
        "service",
    },
}
"""What touches the world: disk, network, clock, terminal, processes."""


@pytest.mark.parametrize(
    ("package", "folder", "contract"),
    [
        ("armrig", "clients", "Only named edges of the clients touch the world"),
        ("armrig_daemon", "daemon", "Only named edges of the daemon touch the world"),
    ],
)
def test_a_new_module_is_pure_or_a_named_edge(package: str, folder: str, contract: str) -> None:
    """`make check` then holds it to that."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    (pure,) = (c["source_modules"] for c in settings["contracts"] if c["name"] == contract)
    there = {
        path.stem
        for path in (ROOT / folder / package).iterdir()
        if (path.suffix == ".py" or (path / "__init__.py").exists()) and path.stem[:2] != "__"
    }

    assert there == {name.removeprefix(f"{package}.") for name in pure} | EDGES[package]
