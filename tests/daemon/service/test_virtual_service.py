"""Runs in virtual time: requested as by a client, recorded as by the daemon."""

from __future__ import annotations

import json
from pathlib import Path

import armrig
import numpy as np
import pytest
from armrig_core.commands.commands import RunRequest
from armrig_core.errors import OperationError
from armrig_daemon.config import Config, Limits
from armrig_daemon.service.virtual_service import LEASE, VirtualService, requests_of
from msgspec.structs import replace

REQUEST = RunRequest(lease=LEASE, n=0, u=[0.0, *np.linspace(0.5, 4.5, 149)], experiment="ramp")


def _recorded(
    folder: Path, seed: int, *requests: RunRequest, config: Config | None = None
) -> list[Path]:
    service = VirtualService(config or Config(), folder, seed=seed)
    return [service.record(request) for request in requests]


def test_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    first, again = (
        _recorded(tmp_path / name, 3, REQUEST, replace(REQUEST, pacing="exchange"))
        for name in ("first", "again")
    )
    [other] = _recorded(tmp_path / "other", 4, REQUEST)

    for one, two in zip(first, again, strict=True):
        assert one.name == two.name
        assert one.read_bytes() == two.read_bytes()
    assert other.name not in {p.name for p in first}
    assert other.read_bytes() != first[0].read_bytes()


def test_a_run_that_ends_early_is_reported(tmp_path: Path) -> None:
    config = Config(limits=Limits(revolutions=0.5))
    service = VirtualService(config, tmp_path, seed=1)
    service._config = Config()  # else the rehearsal sees it coming

    with pytest.raises(OperationError, match="REV_LIMIT"):
        service.record(REQUEST)

    [path] = tmp_path.glob("*.mcap")
    assert 0 < armrig.load(path).samples.size < 150


def test_runs_are_read_from_lines_of_json() -> None:
    line = json.dumps({"u": [1.0, 2.0], "experiment": "x", "details": {"seed": 1}})

    [run] = requests_of(line.encode() + b"\n")

    assert (run.u, run.experiment, run.details) == ([1.0, 2.0], "x", {"seed": 1})
    with pytest.raises(ValueError, match=r"line 2 is no run: .*<= 5.0"):
        requests_of(f'{line}\n{{"u": [6]}}'.encode())
