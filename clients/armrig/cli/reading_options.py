"""Options that choose the file and the data of a command."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from shlex import quote
from typing import Annotated, Literal

from armrig_core.recording_file.part_names import part_paths

from armrig.cli.options import CalibrationFile, Detrend, From, To, argument, chosen
from armrig.cli.printing import inform
from armrig.data.files import OTHER_DATA, RECORDING

_NAMES = "@last or @NAME"


def recording_path(text: str) -> Path:
    """Return the path of a recording from its path or @name; print what the @name means.

    Raises
    ------
    NoSuchRecordingError
        No recording has the name, or several recordings have the name.
    """
    from armrig.recordings.recording_names import chosen, described, recording_folder

    if not text.startswith("@"):
        _check_bare_name(Path(text))
        return Path(text)
    found = chosen(text, recording_folder())
    about = described(found).removeprefix(f"{text}, ")  # an id is not repeated
    inform(f"{text} is {about}", dim=True)
    return found.path


def _check_bare_name(path: Path) -> None:
    """Refuse a word that is not a file: a name without @, or a file without its suffix."""
    if path.suffix or path.parent != Path() or path.exists():
        return
    from armrig.recordings.recording_names import NoSuchRecordingError

    beside = path.with_suffix(RECORDING)
    is_there = path.name and part_paths(beside)[0].exists()
    meant = str(beside) if is_there else f"@{path}"
    raise NoSuchRecordingError(f"{path}: there is no such file; did you mean {meant}?")


OtherFile = Annotated[
    Path | None, argument("F2", "Recording for validation.", False, parser=recording_path)
]
File = Annotated[Path, argument("F", f"Recording (*.mcap), {_NAMES}.", parser=recording_path)]
DataFile = Annotated[
    Path, argument("F", f"Recording (*.mcap, {_NAMES}), or {OTHER_DATA}.", parser=recording_path)
]
Assumption = Literal["integrating", "settling"]
READING = ("time", "Ts", "topic", "decimal", "resample", "hold_input", "mask_rails", "unwrap")
"""Options of reading a table, which are arguments of `load_data`."""
PART = ("calibration", "start", "stop")
"""Options of reading a recording."""
_FLAGS = {"start": "--from", "stop": "--to"}
_DIGITS = 12  # of a number in a command line


@dataclass(frozen=True, slots=True, kw_only=True)
class DataOptions:
    """Options that choose and treat the data of a command."""

    input: str | None = chosen(
        None,
        "--input NAME",
        "Column of the input in other data: its name, or its number from 1.",
        "u",
    )
    signal: str | None = chosen(
        None,
        "--signal NAME",
        "Output: theta_1, alpha or velocity; in other data, the column's name, or its number "
        "from 1.",
        "theta_1; y of other data",
    )
    time: str | None = chosen(
        None, "--time NAME", "Column of the times in other data.", "t or time, if there is one"
    )
    Ts: float | None = chosen(None, "--Ts", "Sampling time of other data, in s.", "by the times")
    topic: str | None = chosen(
        None,
        "--topic NAME",
        "Topic of an MCAP file of another program; its messages' fields are the columns.",
    )
    decimal: Literal[",", "."] | None = chosen(
        None,
        "--decimal",
        "Decimal mark of other data: comma or point.",
        "by all numbers of the file",
    )
    resample: bool = chosen(False, "--resample", "Interpolate other data at uneven times.")
    hold_input: bool = chosen(False, "--hold-input", "Hold the input where its cell is empty.")
    mask_rails: bool = chosen(
        False, "--mask-rails", "Mark samples at a rail of the converter as missing."
    )
    unwrap: float | None = chosen(
        None,
        "--unwrap RANGE",
        "Remove the jumps of a counter or angle that wraps, such as 65536 or 360.",
    )
    detrend: Detrend = False
    hampel: bool = chosen(False, "--hampel", "Mark single outliers of the output as missing.")
    assume: Assumption | None = chosen(
        None,
        "--assume",
        "Take the output as the integral of its rate, or as an output that settles.",
        "a test of the data decides",
    )
    calibration: CalibrationFile = None
    start: From = None
    stop: To = None

    def given(self, *names: str) -> list[str]:
        """Return the options that differ from their defaults, as a user types them."""
        typed = []
        for name in names or OPTIONS:
            value = getattr(self, name)
            if value is None or value is False:  # not 0.0
                continue
            text = f"{value:.{_DIGITS}g}" if isinstance(value, float) else quote(str(value))
            flag = _FLAGS.get(name, f"--{name.replace('_', '-')}")
            typed.append(flag if value is True else f"{flag} {text}")
        return typed


OPTIONS = tuple(field.name for field in fields(DataOptions))
"""Names of all options of `DataOptions`."""
