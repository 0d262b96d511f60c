"""A bug takes the place of its module when that is imported; no file is touched."""

from __future__ import annotations

import ast
import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import CodeType, ModuleType


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
