"""A line that fails: between the daemon's port and the device's, a process of its own.

`python relay.py DEVICE LINK` makes LINK, a port that a daemon opens, and carries bytes between it
and DEVICE. Each line on its standard input is one of its methods, answered with the monotonic time
in ns at which it was carried out.
"""

from __future__ import annotations

import contextlib
import os
import random
import select
import subprocess
import sys
import time
import tty
from collections.abc import Callable
from pathlib import Path

_PRIORITY = 40  # between the loop's and the emulator's
_READ = 4096
_SHARE = 0.05  # of the pieces that noise spoils


class Line:
    """Both ends, and what happens to the bytes between them."""

    def __init__(self, device: Path, link: Path) -> None:
        self._device, self._link = device, link
        self._random = random.Random(1)
        self.ends()
        self._fd = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self.master = -1
        self.sources: list[int] = []
        self.plug()

    def ends(self) -> None:
        """Let all pass again."""
        self.deaf = self.mute = False
        self._spoil: Callable[[bytes], bytes] = bytes

    def unplug(self) -> None:
        """Take the port away, as a cable that is pulled does."""
        self._link.unlink()
        os.close(self.master)
        self.master = -1

    def plug(self) -> None:
        """Make the port, in a step."""
        self.master, slave = os.openpty()
        tty.setraw(slave)
        fresh = self._link.with_suffix(".new")
        fresh.symlink_to(os.ttyname(slave))
        os.close(slave)
        os.set_blocking(self.master, False)
        fresh.replace(self._link)

    def reset(self) -> None:
        """Reset the device, as DTR does."""
        os.close(self._fd)
        self._fd = os.open(self._device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)

    def stop_reading(self) -> None:
        """Leave the host's bytes in its buffer."""
        self.deaf = True

    def stop_answering(self) -> None:
        """Lose the device's answers."""
        self.mute = True

    def flip(self) -> None:
        """Flip a bit here and there, either way."""
        self._spoil = self._flipped

    def garbage(self) -> None:
        """Put bytes in between, either way."""
        self._spoil = lambda data: data + self._random.randbytes(20)

    def cut(self) -> None:
        """Lose the rear of a piece, either way."""
        self._spoil = lambda data: data[: self._random.randrange(len(data))]

    def carry(self) -> bool:
        """Carry the present bytes; return whether the test has sent a line."""
        host = [] if self.deaf or self.master < 0 else [self.master]
        ready, _, _ = select.select([0, self._fd, *host], [], [], 1)
        if self._fd in ready:
            with contextlib.suppress(OSError):
                data = self._noisy(os.read(self._fd, _READ))
                if self.master >= 0 and not self.mute:
                    os.write(self.master, data)
        if self.master in ready:
            try:
                os.write(self._fd, self._noisy(os.read(self.master, _READ)))
            except OSError:  # nobody has it open: do not spin
                time.sleep(0.002)
        return 0 in ready

    def _noisy(self, data: bytes) -> bytes:
        return self._spoil(data) if data and self._random.random() < _SHARE else data

    def _flipped(self, data: bytes) -> bytes:
        at = self._random.randrange(8 * len(data))
        return bytes(b ^ (at // 8 == i) << at % 8 for i, b in enumerate(data))


class Relay:
    """The relay as a test holds it."""

    def __init__(self, device: Path, link: Path) -> None:
        self.popen = subprocess.Popen(
            [sys.executable, __file__, str(device), str(link)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self._answer()

    def do(self, what: str) -> int:
        """Let something happen to the line; return the time of it."""
        assert self.popen.stdin is not None
        self.popen.stdin.write(f"{what}\n")
        self.popen.stdin.flush()
        return self._answer()

    def end(self) -> None:
        """End it."""
        self.popen.kill()
        self.popen.communicate()

    def _answer(self) -> int:
        assert self.popen.stdout is not None
        return int(self.popen.stdout.readline())


def main() -> None:
    """Carry bytes and obey the test, until the test is gone."""
    line = Line(Path(sys.argv[1]), Path(sys.argv[2]))
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    print(time.monotonic_ns(), flush=True)
    while True:
        if not line.carry():
            continue
        asked = sys.stdin.readline().strip()
        if not asked:
            return
        getattr(line, asked)()
        print(time.monotonic_ns(), flush=True)


if __name__ == "__main__":
    main()
