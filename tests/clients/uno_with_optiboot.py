"""An Uno at a pseudo-terminal: its boot loader speaks STK500v1, then its program runs.

The boot loader implements what avrdude needs of the protocol (AVR061, as Optiboot does): a page is
loaded, written and read back. A pseudo-terminal has no DTR, so that the boot loader listens from
the start until it is left.
"""

from __future__ import annotations

import os
import select
import subprocess
import termios
import threading
import time
import tty
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

ROOT = Path(__file__).parents[2]
FIL = ROOT / "firmware_protocol" / "simavr"
ATMEGA328P = bytes((0x1E, 0x95, 0x0F))
_INSYNC, _OK, _END = b"\x14", b"\x10", b" "
# Bytes of each command after its letter, without the ending blank.
_LENGTHS = {b"0": 0, b"A": 1, b"B": 20, b"E": 5, b"P": 0, b"Q": 0, b"U": 2, b"V": 4, b"u": 0}
_LOOK_S = 0.002
_UNHEARD = 2
"""Greetings that avrdude sends to clear the line: it discards what comes within 0.25 s of each.

A loader on a busy machine answers later, and each answer after that is taken for that of another
question. A real one does not hear a greeting during its reset, and avrdude sends three more.
"""


class Program(Protocol):
    """Program after the boot loader: bytes in, frames out, by given time."""

    def receive(self, now_ns: int, data: bytes) -> None: ...
    def advance(self, now_ns: int) -> list[tuple[int, bytes]]: ...
    def close(self) -> None: ...


def harness() -> Path:
    """Return the harness of simavr, built where its sources are newer."""
    subprocess.run(["make", "-s", "-C", str(FIL)], check=True, timeout=120)
    return FIL / "fil"


class Uno:
    """A board on a port, whose flash contains the written bytes."""

    def __init__(self, run: Callable[[bytes, int], Program]) -> None:
        """Switch it on; `run` makes the program of the flash."""
        self.flash = bytearray(b"\xff" * 32768)
        self.written = 0
        """End of the written flash."""
        self.signature = ATMEGA328P
        self.version = (4, 4)
        """Signature of the boot loader: that of an Uno R3."""
        self.speed = 0
        """The only speed at which the boot loader understands anything, of termios; 0: any."""
        self.stuck_bit = False
        """A cell of the flash is worn out."""
        self.falls_silent_at = 1 << 16
        """Address from which on the boot loader does not answer."""
        self.left = False
        """The boot loader was left."""
        self._run = run
        self._address = 0
        self._greetings = 0
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._work)

    def __enter__(self) -> Uno:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)

    def _work(self) -> None:
        while not self._ended.is_set() and not self.left:
            self._command()
        if not self.left:
            return
        program = self._run(bytes(self.flash[: self.written]), 0)
        begun_ns = time.monotonic_ns()
        try:
            self._carry(program, begun_ns)
        finally:
            program.close()

    def _carry(self, program: Program, begun_ns: int) -> None:
        while not self._ended.wait(_LOOK_S):
            now_ns = time.monotonic_ns() - begun_ns
            if select.select([self._master], [], [], 0)[0]:
                program.receive(now_ns, os.read(self._master, 1000))
            for _, frame in program.advance(now_ns):
                os.write(self._master, frame)

    def _command(self) -> None:
        letter = self._take(1)
        if self.speed and termios.tcgetattr(self._slave)[4] != self.speed:
            return
        if letter in (b"d", b"t"):
            size = int.from_bytes(self._take(3)[:2], "big")
            self._page(letter, size)
        elif letter in _LENGTHS:
            given = self._take(_LENGTHS[letter])
            self._greetings += letter == b"0"
            if self._take(1) == _END and self._greetings > _UNHEARD:
                self._answer(self._simple(letter, given))

    def _simple(self, letter: bytes, given: bytes) -> bytes:
        if letter == b"U":
            self._address = 2 * int.from_bytes(given, "little")
        if letter == b"Q":  # the next opening of the port resets a real board, which listens again
            self.left, self._greetings = self.written > 0, 0
        asked = dict(zip(b"\x81\x82", self.version, strict=True)).get(given[0], 3) if given else 3
        return {b"u": self.signature, b"A": bytes((asked,)), b"V": b"\x00"}.get(letter, b"")

    def _page(self, letter: bytes, size: int) -> None:
        at = slice(self._address, self._address + size)
        if letter == b"d":
            self.flash[at] = self._take(size)
            self.written = max(self.written, at.stop)
        if self._take(1) == _END and at.stop <= self.falls_silent_at:
            page = bytearray(self.flash[at])
            page[3] ^= self.stuck_bit
            self._answer(bytes(page) if letter == b"t" else b"")

    def _answer(self, data: bytes) -> None:
        os.write(self._master, _INSYNC + data + _OK)

    def _take(self, n: int) -> bytes:
        """Return the next bytes; fewer where the board is switched off."""
        data = b""
        while len(data) < n and not self._ended.is_set():
            if select.select([self._master], [], [], 0.02)[0]:
                data += os.read(self._master, n - len(data))
        return data
