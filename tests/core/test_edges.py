"""Nothing in daemon and clients touches the world but the edges that the contracts name."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("package", "contract"),
    [
        ("armrig", "Clients: nothing touches the world but these edges"),
        ("armrig_daemon", "Daemon: nothing touches the world but these edges"),
    ],
)
def test_a_new_module_is_pure_or_a_named_edge(package: str, contract: str) -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    (pure,) = (c for c in settings["contracts"] if c["name"] == contract)

    assert pure["source_modules"] == [package]
    assert f"{package}.** -> *" not in pure["ignore_imports"]
