"""A bug takes the place of its module when that is imported; no file of the project is touched.

`plant` does so in this interpreter. In the interpreters that it starts two environment variables do
so: one names a file with the bug, one a folder with a `sitecustomize` that plants it.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType

VARIABLE = "MUTANT_OF_ARMRIG"
"""Names the file to processes that are started. Not `ARMRIG_…`: the daemon refuses to start where
that is none of its settings."""
STARTED = Path(__file__).with_name("started")


class _Loader(SourceFileLoader):
    """Gives the code of another text than that of the file."""

    def __init__(self, fullname: str, path: str, source: str) -> None:
        super().__init__(fullname, path)
        self._source = source

    def get_code(self, fullname: str) -> CodeType:
        """Compile the text."""
        code = compile(self._source, self.path, "exec", dont_inherit=True)
        assert isinstance(code, CodeType)
        return code


class Planted:
    """A finder that knows one module."""

    def __init__(self, module: str, source: str) -> None:
        """Wait for the import of `module`."""
        self._module, self._source = module, source

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Find the module with the bug."""
        if name != self._module:
            return None
        spec = PathFinder.find_spec(name, path, target)
        assert spec is not None
        assert spec.origin is not None
        spec.loader = _Loader(name, spec.origin, self._source)
        return spec


def plant(module: str, source: str) -> None:
    """Let the next import of `module` give that of the source.

    Raises
    ------
    RuntimeError
        It was imported before: nobody would see the bug.
    """
    if module in sys.modules:
        raise RuntimeError(f"{module} is imported already")
    sys.meta_path.insert(0, Planted(module, source))  # type: ignore[arg-type]


def keep(file: Path, module: str, source: str) -> dict[str, str]:
    """Keep a bug in a file; return the variables with which an interpreter starts with it."""
    file.write_text(json.dumps([module, source]), encoding="utf-8")
    before = os.environ.get("PYTHONPATH")
    paths = os.pathsep.join([str(STARTED), *([before] if before else [])])
    return {VARIABLE: str(file), "PYTHONPATH": paths}


def plant_kept(file: str) -> None:
    """Plant the bug that is kept in a file."""
    plant(*json.loads(Path(file).read_text(encoding="utf-8")))


def module_of(path: str) -> str:
    """Return the name of the module that a file of one of the packages is."""
    parts = Path(path).with_suffix("").parts[1:]  # the first one is the folder of the packages
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
