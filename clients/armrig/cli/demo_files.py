"""Files of the demonstration, which a later demonstration writes again."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path

from armrig_core.errors import InputError

from armrig.cli.printing import inform
from armrig.numerics.quantities import plural

LIST = "demo.sha256"
"""Name of the list of the files, as `sha256sum` writes it."""
_NAMES = ("armrig.toml", "armrigd.log", "report.pdf", "*.svg", "demo-*.mcap")
"""Names of the files that the demonstration writes."""
_LINE = re.compile("[0-9a-f]{64}  .+")
_REFUSED = (
    "{path}: is not a file of an earlier demonstration, or was changed; move it, or give another "
    "folder, --directory FOLDER"
)


@contextmanager
def demo_files(directory: Path) -> Iterator[None]:
    """Remove the files of an earlier demonstration, and list the files of this one at its end.

    Raises InputError if a file has the name of one of the demonstration's files, but is not listed,
    or was changed after it was listed. No file is then removed.
    """
    if directory.exists() and not directory.is_dir():
        raise InputError(f"--directory {directory}: is a file; give a directory, which may be new")
    listed, earlier = _read_list(directory / LIST), _present(directory)
    for path in earlier:
        if listed.get(path.name) != _hash(path):
            raise InputError(_REFUSED.format(path=path))
    if earlier:
        written = f"{plural(len(earlier), 'file')} of an earlier demonstration"
        inform(f"{directory}: {written} will be replaced")
    directory.mkdir(parents=True, exist_ok=True)
    for path in earlier:
        path.unlink()
    try:
        yield
    finally:
        lines = (f"{_hash(path)}  {path.name}\n" for path in _present(directory))
        (directory / LIST).write_text("".join(lines), encoding="utf-8")


def _present(directory: Path) -> list[Path]:
    """Return the files with the names of the demonstration's files, sorted by name."""
    return sorted(path for name in _NAMES for path in directory.glob(name))


def _read_list(path: Path) -> dict[str, str]:
    """Return the hashes in a list by the files' names; refuse a file that is no list."""
    if not path.exists():
        return {}
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    if not all(_LINE.fullmatch(line) for line in lines):
        raise InputError(_REFUSED.format(path=path))
    return {name: digest for digest, _, name in (line.partition("  ") for line in lines)}


def _hash(path: Path) -> str:
    return sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
