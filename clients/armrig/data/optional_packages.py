"""Import of the packages of optional extras."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from armrig_core.errors import InputError


class MissingPackageError(InputError, ImportError):
    """An optional package is not installed; the message contains the install command."""

    def __init__(self, msg: str, name: str) -> None:
        ImportError.__init__(self, msg, name=name)


def imported(module: str, extra: str) -> Any:
    """Return the imported module of an optional extra, or raise MissingPackageError."""
    try:
        return import_module(module)
    except ImportError as err:
        name = module.partition(".")[0]
        raise MissingPackageError(
            f"{name} is not installed: pip install {name}, or pip install 'armrig[{extra}]'",
            name=name,
        ) from err
