"""Parameters of which `make test` tries a part, and `make test-all` the others."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import islice
from typing import Any

import pytest


def sampled(values: Iterable[Any], n: int = 1) -> list[Any]:
    """Return the parameters, those after the first `n` marked as exhaustive.

    Examples
    --------
    >>> @pytest.mark.parametrize("number", sampled([signal.SIGINT, signal.SIGTERM]))
    """
    values = iter(values)
    return [*islice(values, n), *(_exhaustive(value) for value in values)]


def without_slow(values: Iterable[Any], slow: Callable[[Any], bool]) -> list[Any]:
    """Return the parameters, the slow ones marked as exhaustive.

    Examples
    --------
    >>> @pytest.mark.parametrize("file", without_slow(FILES, lambda file: file.stem == "report"))
    """
    return [_exhaustive(value) if slow(value) else value for value in values]


def _exhaustive(value: Any) -> Any:
    several = value if isinstance(value, tuple) else (value,)
    return pytest.param(*several, marks=pytest.mark.exhaustive)
