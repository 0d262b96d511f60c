"""A calibration as a TOML of its own, and the samples that it was estimated from beside it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from armrig_core.bounded import read_bounded
from armrig_core.calibration import Calibration, Made
from armrig_core.errors import FileError
from armrig_core.toml_file import read_toml

RAW_LIMIT = 1 << 20
"""Most that the samples of a calibration may take, compressed, in B."""
_HEADING = (
    "# Calibration of a rig, written by `armrig calibrate`. The daemon uses it where its\n"
    '# configuration says [calibration] file = "…". The samples that it was estimated from\n'
    "# lie beside it, in a compressed CSV of the same name.\n"
)


_TOML_LIMIT = 1 << 14  # ten times what we write; the reader's time grows with the square


class LostSamplesError(FileError):
    """The samples of a calibration are not beside its file; all else of it may be whole."""


def raw_path(path: Path) -> Path:
    """Return where the samples of the calibration in `path` lie."""
    return path.with_suffix(".csv.gz")


def toml_of(calibration: Calibration) -> str:
    """Return a calibration as TOML."""
    tables: dict[str, Any] = msgspec.to_builtins(calibration)
    if tables["made"] is None:
        del tables["made"]
    else:
        del tables["made"]["file"]  # where it was read
    lines = [_HEADING]
    _write(tables, "", lines)
    return "\n".join(lines) + "\n"


def tables_of(path: Path) -> dict[str, Any]:
    """Return the tables in the TOML at `path`, not yet checked but for its raw samples.

    Raises
    ------
    FileError
        The file cannot be read or is no TOML, or the samples beside it are not those that it was
        estimated from.
    """
    try:
        tables = read_toml(path, _TOML_LIMIT)
    except OSError as err:
        raise FileError(f"{path}: {err.strerror}") from err
    except FileError as err:
        raise FileError(f"{path}: {err}") from err
    made = tables.get("made")
    if isinstance(made, dict):
        if made.get("raw_sha256"):
            _raw(path, str(made["raw_sha256"]))
        made["file"] = str(path.absolute())
    return tables


def read_calibration(path: Path) -> Calibration:
    """Return the calibration in the TOML at `path`; raises FileError."""
    tables = tables_of(path)
    try:
        return msgspec.convert(tables, Calibration)
    except msgspec.ValidationError as err:
        raise FileError(f"{path}: {err}; `armrig calibrate` writes such files") from err


def check_measured(calibration: Calibration, raw: bytes) -> Made:
    """Return how a calibration was made; refuse one that no file of `armrig calibrate` holds.

    Parameters
    ----------
    raw : bytes
        The compressed samples that it was estimated from.

    Raises
    ------
    FileError
        It was not measured, is longer than a file may be, or `raw` are not its samples.
    """
    made, error = calibration.made, ""
    if made is None:
        raise FileError(
            "the calibration does not say how it was made; `armrig calibrate` makes one"
        )
    if len(toml_of(calibration).encode()) > _TOML_LIMIT:
        error = f"the calibration takes more than the {_TOML_LIMIT} B allowed"
    elif len(raw) > RAW_LIMIT:
        error = f"its samples take {len(raw)} B, at most {RAW_LIMIT} B are allowed"
    elif (hashlib.sha256(raw).hexdigest() if raw else "") != made.raw_sha256:
        error = "the samples beside it are not those that it was estimated from"
    if error:
        raise FileError(f"{error}; calibrate anew with `armrig calibrate`")
    return made


def raw_samples(calibration: Calibration) -> bytes:
    """Return the compressed samples of a calibration that was read from a file, or nothing.

    Raises
    ------
    FileError
        They are not there, too long, or not those that it was estimated from.
    """
    made = calibration.made
    if made is None or not (made.file and made.raw_sha256):
        return b""
    return _raw(Path(made.file), made.raw_sha256)


def _raw(path: Path, sha256: str) -> bytes:
    beside = raw_path(path)
    way_out = f"put it beside {path.name}, or calibrate anew with `armrig calibrate`"
    try:
        data = read_bounded(beside, RAW_LIMIT)
    except OSError as err:
        raise LostSamplesError(f"{beside}: {err.strerror}; {way_out}") from err
    if hashlib.sha256(data).hexdigest() != sha256:
        raise LostSamplesError(
            f"{beside}: not the samples that {path.name} was estimated from; {way_out}"
        )
    return data


def _write(table: Mapping[str, Any], name: str, lines: list[str]) -> None:
    """Append a table: its own values first, then the tables in it."""
    inner = {key: value for key, value in table.items() if isinstance(value, Mapping)}
    plain = {key: value for key, value in table.items() if key not in inner}
    if plain:
        values = (f"{key} = {_value(value)}" for key, value in plain.items())
        lines += [f"[{name}]", *values, ""]
    for key, value in inner.items():
        _write(value, f"{name}.{key}" if name else key, lines)


def _value(value: Any) -> str:
    # JSON's strings, numbers and booleans are TOML's, too.
    return json.dumps(value, ensure_ascii=False)
