"""L1: acknowledged samples survive `kill -9` at any moment."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.daemon import killed_writer

KILLS = 20


@pytest.mark.exhaustive
def test_a_kill_at_any_moment_loses_no_acknowledged_sample(tmp_path: Path) -> None:
    program = [sys.executable, killed_writer.__file__, tmp_path, str(KILLS), "1"]
    subprocess.run(list(map(str, program)), check=True, timeout=300)

    found = killed_writer.judged(tmp_path)

    assert len(found) >= KILLS - 2
    assert {one.faults for one in found} == {()}
    assert sum(one.ledger.acknowledged > 0 for one in found) > KILLS / 4
    assert sum(one.found > one.ledger.acknowledged for one in found) > KILLS / 4
    assert not any(path.stat().st_size for path in tmp_path.glob("*.active"))
