"""Public names of a package, in one list: the imports of its stub, `__init__.pyi`.

Type checkers read the stub. At run time, the module of a name is imported at the first use of the
name (PEP 562), so that `import armrig` and `armrig --help` are quick.
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
    """Return the module of each public name of a package."""
    stub = Path(str(sys.modules[package].__file__)).with_suffix(".pyi")
    body = ast.parse(stub.read_text(encoding="utf-8")).body
    imports = (node for node in body if isinstance(node, ast.ImportFrom))
    return {name.name: str(node.module) for node in imports for name in node.names}


def public(package: str, name: str) -> Any:
    """Return the object with a public name of a package, and store it in the package.

    If the name is unknown, raise AttributeError. A package may first check the name in `homes` and
    raise a more helpful error.
    """
    if name not in homes(package):
        raise AttributeError(f"module {package!r} has no attribute {name!r}", name=name)
    value = getattr(import_module(homes(package)[name]), name)
    setattr(sys.modules[package], name, value)
    return value
