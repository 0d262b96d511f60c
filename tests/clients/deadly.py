"""Work that kills its worker."""

from __future__ import annotations

import os
import signal


def deadly(item: str) -> str:
    """Return an item in capitals; one kills the process that works on it."""
    if item == "deadly":
        os.kill(os.getpid(), signal.SIGKILL)
    return item.upper()
