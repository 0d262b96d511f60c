"""Programs that a test starts and that end with it, also if it fails."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def running(program: list[str], **options: Any) -> Iterator[subprocess.Popen[Any]]:
    """Start a program; kill it at the end of the block, because `Popen` would wait for its end."""
    with subprocess.Popen(program, **options) as process:
        try:
            yield process
        finally:
            process.kill()
