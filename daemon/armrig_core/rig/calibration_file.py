"""The TOML file of a calibration, and the file with the samples of the calibration."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from armrig_core.errors import FileError
from armrig_core.process.bounded import read_bounded
from armrig_core.process.toml_file import read_toml
from armrig_core.rig.calibration import Calibration, Made

RAW_LIMIT = 1 << 20
"""Largest size of the compressed samples of a calibration, in B."""
_HEADING = (
    "# Calibration of a rig, written by `armrig calibrate`. The daemon uses this file if its\n"
    '# configuration contains [calibration] file = "…". The samples from which the calibration\n'
    "# was estimated are in a compressed CSV of the same name in this folder.\n"
)


_TOML_LIMIT = 1 << 14  # in B: ten times the usual size; the time for reading grows with its square


class LostSamplesError(FileError):
    """The samples of a calibration are missing or wrong; the calibration itself may be usable."""


def raw_path(path: Path) -> Path:
    """Return the path of the samples that belong to the calibration file `path`."""
    return path.with_suffix(".csv.gz")


def toml_of(calibration: Calibration) -> str:
    """Return a calibration as TOML."""
    tables: dict[str, Any] = msgspec.to_builtins(calibration)
    if tables["made"] is None:
        del tables["made"]
    else:
        del tables["made"]["file"]  # the path of the file that was read
    lines = [_HEADING]
    _write(tables, "", lines)
    return "\n".join(lines) + "\n"


def tables_of(path: Path) -> dict[str, Any]:
    """Return the tables of the TOML file at `path`; check only the hash of the raw samples.

    Raises FileError if the file cannot be read or is not TOML, or the samples next to it are not
    the samples from which the calibration was estimated.
    """
    tables = read_toml(path, _TOML_LIMIT)
    made = tables.get("made")
    if isinstance(made, dict):
        if made.get("raw_sha256"):
            _raw(path, str(made["raw_sha256"]))
        made["file"] = str(path.absolute())
    return tables


def read_calibration(path: Path) -> Calibration:
    """Return the calibration in the TOML file at `path`; raise FileError if it cannot be used."""
    tables = tables_of(path)
    try:
        return msgspec.convert(tables, Calibration)
    except msgspec.ValidationError as err:
        raise FileError(f"{path}: {err}; `armrig calibrate` writes such files") from err


def check_measured(calibration: Calibration, raw: bytes) -> Made:
    """Return the origin of a calibration; refuse a calibration that was not measured.

    `raw` contains the compressed samples from which the calibration was estimated.

    Raises FileError if the calibration was not measured or is too long, or `raw` are not its
    samples.
    """
    made, error = calibration.made, ""
    if made is None:
        raise FileError(
            "the calibration does not say how it was made; `armrig calibrate` makes one"
        )
    if len(toml_of(calibration).encode()) > _TOML_LIMIT:
        error = f"the calibration has more than {_TOML_LIMIT} B"
    elif len(raw) > RAW_LIMIT:
        error = f"its samples have {len(raw)} B; at most {RAW_LIMIT} B are allowed"
    elif (hashlib.sha256(raw).hexdigest() if raw else "") != made.raw_sha256:
        error = "the samples next to it are not the samples from which it was estimated"
    if error:
        raise FileError(f"{error}; calibrate again with `armrig calibrate`")
    return made


def raw_samples(calibration: Calibration) -> bytes:
    """Return the compressed samples of a calibration; b"" if it has no file or no samples.

    Raises FileError if the samples are missing or too long, or the calibration was not estimated
    from them.
    """
    made = calibration.made
    if made is None or not (made.file and made.raw_sha256):
        return b""
    return _raw(Path(made.file), made.raw_sha256)


def _raw(path: Path, sha256: str) -> bytes:
    samples = raw_path(path)
    way_out = f"put it next to {path.name}, or calibrate again with `armrig calibrate`"
    try:
        data = read_bounded(samples, RAW_LIMIT)
    except OSError as err:
        raise LostSamplesError(f"{samples}: {err.strerror}; {way_out}") from err
    if hashlib.sha256(data).hexdigest() != sha256:
        raise LostSamplesError(
            f"{samples}: not the samples from which {path.name} was estimated; {way_out}"
        )
    return data


def _write(table: Mapping[str, Any], name: str, lines: list[str]) -> None:
    """Append the lines of a table: first its own values, then its nested tables."""
    inner = {key: value for key, value in table.items() if isinstance(value, Mapping)}
    plain = {key: value for key, value in table.items() if key not in inner}
    if plain:
        values = (f"{key} = {_value(value)}" for key, value in plain.items())
        lines += [f"[{name}]", *values, ""]
    for key, value in inner.items():
        _write(value, f"{name}.{key}" if name else key, lines)


def _value(value: Any) -> str:
    # Strings, numbers and booleans have the same form in TOML as in JSON.
    return json.dumps(value, ensure_ascii=False)
