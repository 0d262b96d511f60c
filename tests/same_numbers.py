"""Print every number that the public functions make of fixed data; compare with a file of them.

The calls (`same_numbers_calls.py`) and the walk over their results have two uses:

- Another version on the same machine: `python -m tests.same_numbers > before.json`, and after a
  change `python -m tests.same_numbers before.json`. It prints the worst difference of each call and
  exits with 1 above 1e-9, or if a number is no longer there. A call that a release does not have is
  left out and named. Both runs belong on one machine: another BLAS may round otherwise, and a
  search ends elsewhere within its tolerance.
- The file of the repository, `tests/clients/same_numbers.txt`, on any machine:
  tests/clients/test_same_numbers.py compares with it to 7 figures, and
  `make stored` writes it again after a change that is meant.

A quantity in the file is a line, sorted by name within its call. Few values are all listed; of many
there are the shape, the first, last, least, greatest, mean, effective value, a fixed projection,
and how many are not finite. Texts are left out: words change. The first result of each class in a
call has all its members, with the methods; later ones those of the table `BRIEF`.
"""

from __future__ import annotations

import dataclasses
import enum
import inspect
import json
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from tests import same_numbers_calls as table

Array = NDArray[np.float64]
Quantity = tuple[str, Array]
STORED = Path(__file__).parent / "clients" / "same_numbers.txt"
WITHIN = 1e-9
"""Tolerance between versions on one machine, relative to the quantity's largest number."""
OF_SCALE, OF_ITSELF = 1e-5, 1e-5
"""Tolerances relative to a long quantity's largest number, and to each short one's numbers."""
_ROUNDING = 1e-9  # of the largest number of a short quantity
_LISTED = 12  # values that are all listed
_DEEPEST = 7  # objects within each other


def main(arguments: list[str]) -> int:
    """Print, write the stored file, or compare."""
    if arguments == ["--write"]:
        lines = [f"{name}: {text}\n" for name, text in stored_numbers(table.CALLS)]
        STORED.write_text("".join(lines))
        print(f"{STORED}: {len(lines)} quantities")
        return 0
    found = {call: dict(_forgiving(call)) for call in table.CALLS}
    if not arguments:
        print(json.dumps(_plain(found), indent=1))
        return 0
    return compared(found, json.loads(Path(arguments[0]).read_text()))


def compared(found: dict[str, dict[str, Array]], before: dict[str, dict[str, Any]]) -> int:
    """Print the worst difference of each call; return 1 if one is too large or a number is gone."""
    worst, gone = 0.0, []
    for call, quantities in before.items():
        now = found.get(call, {})
        gone += [name for name in quantities if name not in now]
        off = {name: difference(now[name], b) for name, b in quantities.items() if name in now}
        name = max(off, key=lambda name: off[name], default="")
        print(f"{call:28} {off.get(name, 0.0):8.1e}  {name}")
        worst = max(worst, off.get(name, 0.0))
    for name in gone:
        print(f"no longer there: {name}")
    print(f"{'worst':28} {worst:8.1e}  {'more' if worst > WITHIN else 'not more'} than {WITHIN:g}")
    return int(worst > WITHIN or bool(gone))


def difference(found: Any, before: Any) -> float:
    """Return the largest difference of two arrays, in parts of the largest number before."""
    a, b = (np.atleast_1d(np.array(x, dtype=np.float64)) for x in (found, before))
    if a.size == b.size == 0:
        return 0.0
    if a.shape != b.shape or not np.array_equal(np.isfinite(a), np.isfinite(b)):
        return np.inf
    known = np.isfinite(b)
    if not known.any():
        return 0.0
    scale = float(np.max(np.abs(b[known])))
    return float(np.max(np.abs(a[known] - b[known]))) / (scale or 1.0)


def _forgiving(call: str) -> Iterator[Quantity]:
    try:
        yield from numbers(call)
    except (AttributeError, ImportError, TypeError, ValueError) as err:
        print(f"{call}: left out from here on: {type(err).__name__}: {err}", file=sys.stderr)


def _plain(found: dict[str, dict[str, Array]]) -> dict[str, dict[str, Any]]:
    """Return arrays as lists, and non-finite numbers as None."""
    return {call: {name: _listed(x) for name, x in q.items()} for call, q in found.items()}


def _listed(array: Array) -> Any:
    flat = [x if np.isfinite(x) else None for x in array.ravel().tolist()]
    return np.array(flat, dtype=object).reshape(array.shape).tolist()


# What a call gives, number by number.


def numbers(call: str) -> Iterator[Quantity]:
    """Give the name and the values of each quantity that the variants of a call lead to."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        shown: set[str] = set()
        for variant, result in table.CALLS[call]():
            name, kind = f"{call} {variant}", _kind(result)
            again = kind in table.BRIEF and (
                call in table.PARTS or (kind in shown and call not in table.WHOLE)
            )
            shown.add(kind)
            for of, values in found_in(result, name, depth=int(again)):
                if not any(fnmatch(of, pattern) for pattern in table.LEFT_OUT):
                    yield of, values


def _kind(result: Any) -> str:
    """Return the class of a result, or that of the first of several."""
    several = isinstance(result, list | tuple) and len(result) > 0
    return type(result[0] if several else result).__name__


def found_in(value: Any, name: str, depth: int = 0) -> Iterator[Quantity]:
    """Give the numbers of a value and of its parts."""
    array = _array(value)
    if array is not None:
        yield name, array
    elif isinstance(value, np.ndarray) and value.dtype.names:
        for field in value.dtype.names:
            yield from found_in(value[field], f"{name}.{field}", depth)
    elif isinstance(value, Mapping) and value and all(isinstance(key, int) for key in value):
        yield from found_in(sorted(value.items()), name, depth)
    elif isinstance(value, Mapping):
        for key, item in value.items():
            yield from found_in(item, f"{name}[{key}]", depth)
    elif isinstance(value, tuple) and hasattr(value, "_fields"):
        yield from found_in(value._asdict(), name, depth)
    elif isinstance(value, list | tuple):
        if value:
            yield f"{name}.len", np.array(float(len(value)))
        yield from _rows(value, name, depth)
    elif type(value).__module__.startswith("armrig") and not isinstance(value, type | enum.Enum):
        if depth < _DEEPEST and not inspect.isroutine(value):
            yield from _members(value, name, depth + 1)
    elif type(value).__module__.startswith("control."):
        for part in ("A", "B", "C", "D", "num_array", "den_array", "omega", "frdata"):
            yield from found_in(getattr(value, part, None), f"{name}.{part}", depth)


def _array(value: Any) -> Array | None:
    """Return a number, or an array of numbers, as floats; complex ones in pairs."""
    if isinstance(value, bool | int | float | complex | np.number | np.bool_):
        value = np.asarray(value)
    if isinstance(value, slice | range):
        value = np.array([value.start, value.stop, value.step or 1], dtype=np.float64)
    if isinstance(value, list | tuple) and not hasattr(value, "_fields") and value:
        numeric = all(isinstance(x, bool | int | float | complex | np.number) for x in value)
        value = np.array(value) if numeric else value
    if not isinstance(value, np.ndarray):
        return None
    if value.dtype == object and value.shape and all(isinstance(x, np.ndarray) for x in value.flat):
        value = np.concatenate([np.ravel(x) for x in value.flat])
    if value.dtype.kind == "c":
        value = np.stack([value.real, value.imag], axis=-1)
    return value.astype(np.float64) if value.dtype.kind in "biuf" else None


def _rows(items: Any, name: str, depth: int) -> Iterator[Quantity]:
    """Give what all items have in one shape as one array, and the rest item by item."""
    found = [dict(found_in(item, "", depth)) for item in items]
    first = found[0] if len(found) > 1 else {}
    alike = [k for k, x in first.items() if all(k in f and f[k].shape == x.shape for f in found)]
    for of in alike:
        yield f"{name}[*]{of}", np.stack([f[of] for f in found])
    for i, quantities in enumerate(found):
        for of, x in quantities.items():
            if of not in alike:
                yield f"{name}[{i}]{of}", x


def _members(value: Any, name: str, depth: int) -> Iterator[Quantity]:
    """Give the numbers of each public attribute, property, and method that the table can call."""
    kind = type(value)
    fields = [f.name for f in dataclasses.fields(kind)] if dataclasses.is_dataclass(kind) else []
    public = [n for n in dir(kind) if not n.startswith("_") and n not in fields]
    brief = table.BRIEF.get(kind.__name__) if depth > 1 else None
    for member in brief or (*fields, *public):
        if any(fnmatch(f"{kind.__name__}.{member}", p) for p in table.NO_MEMBERS):
            continue
        described = inspect.getattr_static(kind, member, None)
        if isinstance(described, classmethod | staticmethod):
            continue
        if not inspect.isfunction(described):
            try:
                found = getattr(value, member)
            except ValueError:
                yield f"{name}.{member} raises", np.array(1.0)
                continue
            yield from found_in(found, f"{name}.{member}", depth)
            continue
        # Methods of what is a part of a result: another call has such a part as its result.
        for shown, arguments in _arguments(value, member, described) if depth == 1 else ():
            try:
                found = getattr(value, member)(**arguments)
            except ValueError:
                yield f"{name}.{member}({shown}) raises", np.array(1.0)
                continue
            yield from found_in(found, f"{name}.{member}({shown})", depth)


def _arguments(
    value: Any, member: str, function: Callable[..., Any]
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Give the table's arguments of a method; a method without an entry is an error."""
    if member in table.METHODS:
        for shown, make in table.METHODS[member].items():
            yield shown, make(value)
        return
    parameters = list(inspect.signature(function).parameters.values())[1:]
    variadic = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    required = [p.name for p in parameters if p.default is p.empty and p.kind not in variadic]
    if not all(p in table.ARGUMENTS for p in required):
        raise LookupError(
            f"{type(value).__name__}.{member}({', '.join(required)}) is public and has no "
            "argument: add it to ARGUMENTS, METHODS or NO_MEMBERS of same_numbers_calls.py"
        )
    yield "", {p: table.ARGUMENTS[p](value) for p in required}


# The stored file.


def stored_numbers(calls: Any) -> Iterator[tuple[str, str]]:
    """Give the lines of calls, without repetitions within a call."""
    for call in calls:
        known: set[str] = set()
        for name, text in sorted(lines(call)):
            if len(text) < 8 or text not in known:
                yield name, text
            known.add(text)


def lines(call: str) -> Iterator[tuple[str, str]]:
    """Give the line of each quantity of a call."""
    return ((name, line(values)) for name, values in numbers(call))


def line(values: Array) -> str:
    """Return the text of a quantity."""
    flat = values.ravel()
    if flat.size <= _LISTED:
        shape = f"{list(values.shape)} " if values.ndim else ""
        return shape + " ".join(f"{x:.10g}" if x == np.rint(x) else f"{x:.7g}" for x in flat)
    x = flat[np.isfinite(flat)]
    lost = f" {flat.size - x.size} not finite" if x.size < flat.size else ""
    if not x.size:
        return f"{list(values.shape)}{lost}"
    # The weights are of no library's generator, whose stream may change.
    weights = np.modf(np.arange(1, flat.size + 1) * 0.6180339887498949)[0] - 0.5
    projection = weights[np.isfinite(flat)] @ x / np.sqrt(flat.size)
    rms = np.sqrt(np.mean(x**2))
    seven = (x[0], x[-1], x.min(), x.max(), x.mean(), rms, projection)
    return f"{list(values.shape)} " + " ".join(f"{v:.7g}" for v in seven) + lost


def read_stored() -> dict[str, str]:
    """Return the lines of the stored file."""
    return dict(row.split(": ", 1) for row in STORED.read_text().splitlines())


def unlike(name: str, now: str, before: str) -> bool:
    """Return whether a line differs beyond rounding."""
    within = next((t for p, (t, _) in table.LOOSER.items() if fnmatch(name, p)), None)
    heads, values = zip(*(_parted(text) for text in (now, before)), strict=True)
    if heads[0] != heads[1] or values[0].shape != values[1].shape:
        return True
    a, b = values
    if not np.array_equal(np.isfinite(a), np.isfinite(b)):
        return True
    a, b = a[np.isfinite(b)], b[np.isfinite(b)]
    if np.array_equal(a, b):
        return False
    scale = np.abs(b).max()
    summary = _many(heads[1])
    allowed = (within or OF_SCALE) * scale if summary else (within or OF_ITSELF) * np.abs(b)
    return bool((np.abs(a - b) > allowed + _ROUNDING * scale + table.ZERO).any())


def _parted(text: str) -> tuple[str, Array]:
    """Return shape and the number that is not finite as a text, and the values."""
    shape, _, rest = text.rpartition("] ") if text.startswith("[") else ("", "", text)
    words = rest.split()
    lost = ""
    if words[-2:] == ["not", "finite"]:
        lost, words = words[-3], words[:-3]
    return f"{shape}]{lost}", np.array(words, dtype=np.float64)


def _many(head: str) -> bool:
    shape = [int(n) for n in head.partition("]")[0].strip("[").split(",") if n]
    return int(np.prod(shape)) > _LISTED if shape else False


def changes(call: str, before: dict[str, str]) -> Iterator[str]:
    """Give a line for each changed quantity of a call."""
    now, known = dict(lines(call)), {n: t for n, t in before.items() if n.split(" ")[0] == call}
    same = {now[name] for name in known if name in now}
    for name, text in now.items():
        if name in known:
            if unlike(name, text, known[name]):
                yield f"{name}: was {known[name]}\n{'':{len(name)}}   is {text}"
        # What is not in the file says what another line says, perhaps with other roundings.
        elif text not in same and all(unlike(name, text, t) for t in known.values()):
            yield f"{name}: is new: {text}"
    for name, text in known.items():
        if name not in now:
            yield f"{name}: is gone, was {text}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
