"""Late imports: the public names of a package, and the packages of optional extras.

The stub of a package, `__init__.pyi`, lists the public names in its imports, and type checkers read
it. At run time, the module of a name is imported at the first use of the name (PEP 562), so that
`import armrig` and `armrig --help` are quick.
"""

from __future__ import annotations

import ast
import sys
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from armrig_core.errors import InputError


@cache
def homes(package: str) -> dict[str, str]:
    """Return the module of each public name of a package, without the packages inside it."""
    stub = Path(str(sys.modules[package].__file__)).with_suffix(".pyi")
    body = ast.parse(stub.read_text(encoding="utf-8")).body
    imports = (node for node in body if isinstance(node, ast.ImportFrom))
    outside = (node for node in imports if node.module != package)
    return {name.name: str(node.module) for node in outside for name in node.names}


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


class MissingPackageError(InputError, ImportError):
    """An optional package is not installed; the message contains the install command."""

    def __init__(self, msg: str, name: str) -> None:
        ImportError.__init__(self, msg, name=name)


def load_extra(module: str, extra: str) -> Any:
    """Return the imported module of an optional extra, or raise MissingPackageError."""
    try:
        return import_module(module)
    except ImportError as err:
        name = module.partition(".")[0]
        raise MissingPackageError(
            f"{name} is not installed: pip install {name}, or pip install 'armrig[{extra}]'",
            name=name,
        ) from err
