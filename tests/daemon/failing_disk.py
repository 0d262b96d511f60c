"""A disk whose n-th call of a kind fails, once or from there on."""

from __future__ import annotations

import errno
import io
import os
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock


class Disk:
    """Counts its calls; the `n`-th call of `kind` fails, or each from there on."""

    def __init__(self, kind: str = "", n: int = 0, *, on: bool = False) -> None:
        self.calls: Counter[str] = Counter()
        self.failed = 0
        self._kind, self._n, self._on = kind, n, on

    def asked(self, kind: str) -> None:
        """Count one call, or fail it."""
        self.calls[kind] += 1
        n = self.calls[kind]
        if kind == self._kind and (n == self._n or (n > self._n and self._on)):
            self.failed += 1
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    @contextmanager
    def installed(self) -> Iterator[None]:
        """Replace the calls of the recorder."""
        counted = {name: self._counted(name) for name in ("fsync", "fdatasync")}
        counted["ftruncate"] = self._counted("ftruncate", os.ftruncate)
        counted["posix_fallocate"] = self._counted("posix_fallocate", os.posix_fallocate)
        with mock.patch.multiple(os, **counted):
            yield

    def path(self, path: Path) -> Path:
        placed = _Path(path)
        placed.disk = self
        return placed

    def _counted(
        self, name: str, function: Callable[..., Any] = lambda *_: None
    ) -> Callable[..., Any]:
        """Count a call that does nothing by default, so that no test waits for a disk."""

        def counted(*args: Any) -> Any:
            self.asked(name)
            return function(*args)

        return counted


class _File(io.FileIO):
    """An unbuffered file of a disk."""

    disk: Disk

    def write(self, data: Any) -> int:
        self.disk.asked("write")
        return super().write(data) or 0

    def readinto(self, buffer: Any) -> int | None:
        self.disk.asked("read")
        return super().readinto(buffer)


class _Path(type(Path())):
    """A path of a disk, as every path made of it."""

    disk: Disk

    def with_name(self, name: str) -> Any:
        return self.disk.path(Path(self).with_name(name))

    def open(self, mode: str = "r", buffering: int = -1, **__: Any) -> Any:
        self.disk.asked("open")
        raw = _File(str(self), mode.replace("b", ""))
        raw.disk = self.disk
        if buffering == 0:
            return raw
        return io.BufferedReader(raw) if mode == "rb" else io.BufferedWriter(raw)

    def rename(self, target: Any) -> Any:
        self.disk.asked("rename")
        return Path(self).rename(target)

    def replace(self, target: Any) -> Any:
        self.disk.asked("rename")
        return Path(self).replace(target)

    def unlink(self, missing_ok: bool = False) -> None:
        self.disk.asked("unlink")
        Path(self).unlink(missing_ok=missing_ok)
