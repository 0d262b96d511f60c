"""A bug takes the place of its module when that is imported; no file is touched.

In this interpreter by `plant`; in those that it starts by two variables of the environment: one
names the bug, the other leads to a `sitecustomize` that plants it.
"""

from __future__ import annotations

import ast
import os
import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from importlib.util import find_spec
from pathlib import Path
from types import CodeType, ModuleType

from mutation.sites import planted

PACKAGE = "armrig_daemon"
VARIABLE = "MUTANT_OF_ARMRIG"
"""Names the bug to processes that are started, as `service.recorder:17`. Not `ARMRIG_…`: the daemon
refuses to start where that is none of its settings."""
STARTED = Path(__file__).with_name("started")


class _Loader(SourceFileLoader):
    """Gives the code of a syntax tree instead of that of the file."""

    def __init__(self, fullname: str, path: str, tree: ast.Module) -> None:
        super().__init__(fullname, path)
        self._tree = tree

    def get_code(self, fullname: str) -> CodeType:
        """Compile the tree; lines are those of the file."""
        code = compile(self._tree, self.path, "exec", dont_inherit=True)
        assert isinstance(code, CodeType)
        return code


class Planted:
    """A finder that knows one module."""

    def __init__(self, module: str, tree: ast.Module) -> None:
        """Wait for the import of `module`."""
        self._module, self._tree = module, tree

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Find the module with the bug, where it is asked for."""
        if name != self._module:
            return None
        spec = PathFinder.find_spec(name, path, target)
        assert spec is not None
        assert spec.origin is not None
        spec.loader = _Loader(name, spec.origin, self._tree)
        return spec


def plant(module: str, tree: ast.Module) -> None:
    """Let the next import of `module` give that of the tree.

    Raises
    ------
    RuntimeError
        It was imported before: nobody would see the bug.
    """
    if module in sys.modules:
        msg = f"{module} is imported already"
        raise RuntimeError(msg)
    sys.meta_path.insert(0, Planted(module, tree))  # type: ignore[arg-type]


def plant_named(name: str) -> None:
    """Plant the bug of this name, without an import of anything beside it."""
    whole = name if name.startswith("armrig_") else f"{PACKAGE}.{name}"
    module, _, number = whole.rpartition(":")
    plant(module, planted(path_of(module).read_text(encoding="utf-8"), int(number)).tree)


def plant_in_started(name: str) -> dict[str, str]:
    """Return the variables with which an interpreter starts with the bug of this name in it."""
    before = os.environ.get("PYTHONPATH")
    paths = os.pathsep.join([str(STARTED), *([before] if before else [])])
    return {VARIABLE: name, "PYTHONPATH": paths}


def path_of(module: str) -> Path:
    """Return the file of a module.

    Found by its package, which is not imported: a bug must be there before its module is.
    """
    name, *rest = module.split(".")
    package = find_spec(name)
    assert package is not None
    assert package.submodule_search_locations is not None
    return Path(package.submodule_search_locations[0]).joinpath(*rest).with_suffix(".py")
