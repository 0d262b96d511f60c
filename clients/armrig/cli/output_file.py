"""A file to be written: refused, before any work, where it cannot or must not be."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from armrig_core.errors import InputError

_MCAP = b"\x89MCAP0\r\n"


def check_output(path: Path, inputs: Sequence[Path], suffix: str = "") -> None:
    """Refuse, before any work, a file that cannot be written, or must not: a recording is kept."""
    name = f"-o {path}" if suffix else str(path)
    if path.is_dir():
        example = path / ("report.pdf" if suffix else "timing.png")
        raise InputError(f"{name}: is a directory; give a file, such as {example}")
    if path.exists() and any(f.exists() and path.samefile(f) for f in inputs):
        raise InputError(
            f"{name}: is one of the files to read, which would be lost; give another name"
        )
    if path.is_file():
        with path.open("rb") as file:
            if file.read(len(_MCAP)) == _MCAP:
                raise InputError(f"{name}: is a recording, which would be lost; give another name")
    if suffix and path.suffix.lower() != suffix:
        raise InputError(f"{name}: a report is a PDF; give a name that ends in {suffix}")
    if not path.absolute().parent.is_dir():
        if path.parent.exists():
            msg = f"{name}: {path.parent} is a file; give a directory that is there"
        else:
            msg = f"{name}: there is no directory {path.parent}; make it first"
        raise InputError(msg)
