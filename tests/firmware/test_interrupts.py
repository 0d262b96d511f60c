"""An interrupt between any two accesses to memory acts as before or after them."""

from __future__ import annotations

import re
import subprocess

from tests.firmware import library
from tests.tools import needs

pytestmark = needs("cc", "make")


def test_the_state_of_the_core_is_consistent_at_any_interrupt() -> None:
    """Setpoints, samples, EXCHANGE and the way out of RUN; `boards/pc/interrupts.c` says how."""
    program = library.build("interrupts", "BOARD_QUEUE=64")

    done = subprocess.run([program], capture_output=True, text=True, check=False, timeout=60)

    assert done.returncode == 0, done.stderr[-3000:]
    (came,) = re.findall(r"interrupts (\d+)", done.stdout)
    assert int(came) > 100_000
