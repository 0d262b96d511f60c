"""A package's public names, in one list: the imports of its stub, `__init__.pyi`.

Checkers of types read the stub; here a name's module is imported when the name is first asked for
(PEP 562), so that `import armrig` and `armrig --help` are quick.
"""

from __future__ import annotations

import ast
import sys
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any


@cache
def homes(package: str) -> dict[str, str]:
    """Return the module of each public name of a package, by name."""
    stub = Path(str(sys.modules[package].__file__)).with_suffix(".pyi")
    body = ast.parse(stub.read_text(encoding="utf-8")).body
    imports = (node for node in body if isinstance(node, ast.ImportFrom))
    return {name.name: str(node.module) for node in imports for name in node.names}


def public(package: str, name: str) -> Any:
    """Return a public name of a package, and keep it there; AttributeError if it has no such name.

    What a module says of a name that is missing may say more: `homes` has those that are there.
    """
    if name not in homes(package):
        raise AttributeError(f"module {package!r} has no attribute {name!r}", name=name)
    value = getattr(import_module(homes(package)[name]), name)
    setattr(sys.modules[package], name, value)
    return value
