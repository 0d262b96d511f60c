"""Recording of one run, on a complete grid of samples."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from armrig_core.errors import FileError, InputError
from armrig_core.process.imports import load_extra
from armrig_core.recording_file.manifest import Manifest, Outcome, Recovered
from armrig_core.rig.calibration import Calibration
from armrig_core.rig.description import Description
from numpy.typing import NDArray

from armrig.data.columns import Vector as Vector
from armrig.data.dataset import Dataset, Signals
from armrig.data.files import IMPORTED
from armrig.data.step import Step, law_step, took
from armrig.data.treatment import difference
from armrig.numerics.quantities import plural
from armrig.numerics.stretches import Mask
from armrig.plots.layout import figure_of, html
from armrig.recordings.daemon_reports import DeviceClock, Event, Gap, Note, Timing

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame
    from xarray import Dataset as XarrayDataset


class Channel(NamedTuple):
    """Values of a channel of the rig, and their validity."""

    y: Vector
    """Values in the channel's unit, (N,); NaN where they are not valid."""
    valid: Mask


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Recording:
    """Recording of one run; element i of an array (N,) belongs to sample `k_first` + i.

    Each sample that was due has a row. In the row of a missing sample, the channels are NaN.

    The names of the channels are those of the rig's description. `recording["T1"]`, or
    `recording.T1`, is the values of a channel in its unit, (N,), NaN where they are not valid.
    `valid_T1` is its mask, and `valid` the mask of the first channel. A turning shaft's angle is
    unwrapped.

    Examples
    --------
    >>> recording = armrig.example_recording()
    >>> recording
    <Recording 2ac691c3170e: blackbox, 3000 samples at 0.01 s; 97 in the dead band or just after>
    >>> recording.alpha[:3].round(3), recording.gaps
    (array([0.006, 0.   , 0.   ]), ())
    """

    path: Path
    """Path of the file."""
    name: str
    """Name in messages: the `@NAME` by which the recording was loaded, or the name of the file."""
    sha256: str
    """Hash of the whole file."""
    manifest: Manifest
    """Manifest of the run."""
    outcome: Outcome | None
    """Outcome of the run; None if the file contains no outcome."""
    recovered: Recovered | None = None
    """Record of the file's recovery after its recorder died; None if no recovery was needed."""
    calibration: Calibration | None = None
    """Conversion of counts to angles and of codes to volts; None if missing.

    The angles and voltages are computed with this calibration from counts and codes. Without a
    calibration, the angles and voltages are the daemon's values. The field `made` contains the
    origin of the calibration.
    """
    k_first: int = 0
    """Index k of the first row; in older files, the index of the first sample that arrived."""
    t: Vector
    """Time at which each sample was due, in s from the first sample of the run, (N,)."""
    u: Vector
    """Voltage in V at the motor's terminals, (N,).

    The device held `u[i]` from `t[i]` until the next sample. The calibration converts the voltage
    of the code to the voltage at the terminals. For a missing sample, `u` is the voltage in the gap
    record, or NaN without a gap record.
    """
    r: Vector | None = None
    """Reference of the run in control, (N,) in the law's unit; None for other runs.

    The reference of a missing sample is known, and the last value is held after its end. The first
    part of a run contains the reference of a law, so a later part has None.
    """
    decisions: Callable[[], Mapping[str, Vector]] | None = None
    """Function that reads the decisions of a run in control from the files; None for other runs."""
    channels: Mapping[str, Channel]
    """Channels of the rig by name, in the order of the device's readings.

    A mask is False for a missing sample, and at a rail (end of the reading's range). For a turning
    shaft it is False also at the first sample after the dead band.
    """
    description: Description
    """Description of the rig, as attached to the file; without an attached one, the arm's."""
    present: Mask
    """Mask (N,), True if the sample arrived."""
    turns_unknown: tuple[int, ...]
    """Rows at which a number of turns becomes uncertain, after many missing samples; of imported
    data, rows at which a new experiment begins."""
    samples: NDArray[np.void]
    """Structured array of the samples that arrived, with raw counts and all times."""
    gaps: tuple[Gap, ...] = ()
    """Missing samples, as the daemon recorded them."""
    events: tuple[Event, ...] = ()
    """Log messages of the daemon."""
    notes: tuple[Note, ...] = ()
    """Notes that people wrote during the run."""
    timing: tuple[Timing, ...] = ()
    """Reports of the timing, one per second."""
    clock: tuple[DeviceClock, ...] = ()
    """Comparisons of the device's clock with the host's clock, one per second."""
    truncated: bool = False
    """True if the file is incomplete or damaged: see `damage`."""
    cut_off: bool = False
    """True if reading ended because the file is truncated, not because of another error."""
    damage: str = ""
    """Damage of the file, and the amount of data that could be read; "" for a complete file."""
    part: tuple[float, float] | None = None
    """Start and end of the loaded range, in s as in `t`; None if all samples were loaded."""
    unhashed: tuple[str, ...] = ()
    """Names of the attachments without a hash in the manifest, as in older files."""

    @property
    def N(self) -> int:
        """Number of samples, including missing samples."""
        return int(self.t.size)

    @property
    def Ts(self) -> float:
        """Time between two samples, in s.

        A sampling time above 1 s is made by the client: see `Rig.arm`. It is that of `dataset`.
        """
        return self.manifest.Ts

    @property
    def is_imported(self) -> bool:
        """True if the data are from another program: there is no rig, device or clock."""
        return self.manifest.kind == IMPORTED

    @property
    def asked_s(self) -> float:
        """Length of the requested input, in s."""
        return max(self.manifest.samples, 0) * self.Ts

    @property
    def missing(self) -> int:
        """Number of samples that were due before the end of the file but did not arrive."""
        return self.N - int(self.samples.size)

    @property
    def first(self) -> str:
        """Name of the first channel, which is the default output."""
        return next(iter(self.channels))

    @property
    def valid(self) -> Mask:
        """Mask (N,) of the first channel."""
        return self.channels[self.first].valid

    @property
    def hidden(self) -> int:
        """Number of arrived samples without a valid first channel, such as in a dead band."""
        return int(np.count_nonzero(self.present & ~self.valid))

    @property
    def short_hash(self) -> str:
        """First twelve digits of the hash, as shown in figures."""
        return self.sha256[:12]

    def channel(self, name: str) -> Channel:
        """Return the values of a channel of the rig, such as "T1".

        Examples
        --------
        >>> alpha = armrig.example_recording().channel("alpha")
        >>> alpha.y.shape, bool(alpha.valid.all())
        ((3000,), True)
        """
        if name not in self.channels:
            raise InputError(f"channel {name!r}: the recording has {', '.join(self.channels)}")
        return self.channels[name]

    def __getitem__(self, name: str) -> Vector:
        """Return the values of a channel, such as `recording["T1"]`."""
        return self.channel(name).y

    def __getattr__(self, name: str) -> NDArray[Any]:
        """Return the values of a channel of this name, or its mask for `valid_` and its name."""
        channels: Mapping[str, Channel] = object.__getattribute__(self, "channels")
        if name in channels:
            return channels[name].y
        if (channel := name.removeprefix("valid_")) != name and channel in channels:
            return channels[channel].valid
        has = ", ".join(channels)
        rig = self.description.title
        raise AttributeError(f"a recording of the rig '{rig}' has no {name}: {has}")

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs for models: the channels, and their rates."""
        rates = (c.rate for c in self.description.channels if c.rate)
        return (*self.channels, *rates)

    def dataset(self, output: str | None = None) -> Dataset:
        """Return the dataset of u and one output for identification, with missing samples marked.

        A sample with an unknown input is left out, and a new experiment begins after it. For a
        turning shaft, a new experiment also begins where the number of turns is unknown.

        Parameters
        ----------
        output : str, optional
            Name of a channel or of its rate: for the arm theta_1, alpha or velocity, the rate of
            theta_1. The rate is computed from differences. The default is the first channel.

        Raises
        ------
        FileError
            There is no valid sample, or the output does not exist.

        Examples
        --------
        >>> recording = armrig.example_recording()
        >>> recording.dataset("alpha")
        <Dataset: 3000 samples at 0.01 s; output alpha [rad]>
        >>> recording.dataset("velocity").unit
        'rad/s'
        """
        output = self.first if output is None else output
        if output not in self.outputs:
            raise InputError(f"output={output!r}: a recording has {', '.join(self.outputs)}")
        measured = next(c for c in self.description.channels if output in (c.name, c.rate))
        y, valid = self.channel(measured.name)
        at, has_input = self._instants()
        y, valid = y[at], valid[at]
        if not (valid & has_input).any():
            raise FileError(
                f"{self.path}: none of its {self.N} samples shows {output}; record again"
            )
        begins = ~has_input
        begins[1:] = ~has_input[:-1]
        begins[:1] = True
        if measured.turns or self.is_imported:
            unknown = np.searchsorted(at, self.turns_unknown)
            begins[unknown[unknown < at.size]] = True
        rig_input = self.description.input
        data = Dataset(
            u=rig_input.value(self.u[at][has_input]),
            y=y[has_input],
            Ts=self.manifest.every * self.Ts,
            valid=valid[has_input],
            starts=np.flatnonzero(begins[has_input]).tolist() or [0],
            output=measured.name,
            unit=measured.unit,
            input=rig_input.name,
            input_unit=rig_input.unit,
            input_scale=(rig_input.offset, rig_input.per_volt),
            source=self.sha256,
            history=self._history(),
            r=None if self.r is None else self.r[at][has_input],
        )
        return difference(data) if output == measured.rate else data

    def _history(self) -> list[Step]:
        """Return the steps of the data's history: the law of the run, and the loaded part."""
        law = self.manifest.controller_sha256
        steps = [law_step(law)] if isinstance(law, str) else []
        if self.part:
            steps.append(took("took {:g} to {:g} s of the run".format(*self.part), *self.part))
        return steps

    def _instants(self) -> tuple[NDArray[np.int_], Mask]:
        """Return the rows of the instants of the client's sampling time.

        The mask is True where the input is known, and is the same until the next instant.
        """
        every, k_first = self.manifest.every, self.manifest.k_first
        at = np.arange((k_first - self.k_first) % every, self.N, every)
        if every == 1 or not at.size:
            return at, np.isfinite(self.u[at])
        held = np.repeat(self.u[at], np.diff([*at, self.N]))
        return at, np.logical_and.reduceat(self.u[at[0] :] == held, at - at[0])

    def signals(self, outputs: Sequence[str] | None = None) -> Signals:
        """Return u and several outputs for identification, with missing samples marked.

        If the dataset of one output begins a new experiment at a sample, a new experiment begins
        there for all outputs.

        Parameters
        ----------
        outputs : sequence of str, optional
            Outputs, as for `dataset`; the default is all channels.

        Raises
        ------
        FileError
            An output has no valid sample, or does not exist.

        Examples
        --------
        >>> signals = armrig.example_recording().signals(["theta_1", "alpha"])
        >>> signals.outputs, signals.inputs
        (('theta_1', 'alpha'), ('u',))
        """
        chosen = self.channels if outputs is None else outputs
        each = [self.dataset(output) for output in chosen]
        if not each:
            raise InputError("outputs=() must name at least one output")
        history = dict.fromkeys(step for data in each for step in data.history)
        return Signals(
            u=each[0].u,
            y=np.column_stack([data.y for data in each]),
            Ts=each[0].Ts,
            valid=np.column_stack([data.valid for data in each]),
            starts=sorted({start for data in each for start in data.starts}),
            inputs=[each[0].input],
            input_scales=[each[0].input_scale],
            outputs=[data.output for data in each],
            input_units=[each[0].input_unit],
            units=[data.unit for data in each],
            source=self.sha256,
            history=list(history),
            r=each[0].r,
        )

    def to_pandas(self) -> DataFrame:
        """Return the columns of the export as a DataFrame: one row per sample, indexed by t in s.

        Raises
        ------
        ImportError
            pandas is not installed.

        Examples
        --------
        >>> table = armrig.example_recording().to_pandas()
        >>> table.index.name, len(table)
        ('t', 3000)
        >>> table[["u", "alpha"]].loc[1.0].round(2).to_dict()
        {'u': 4.5, 'alpha': -0.31}
        """
        pandas = load_extra("pandas", "pandas")
        frame: DataFrame = pandas.DataFrame(export_columns(self)).set_index("t")
        frame.attrs.update(export_metadata(self))
        return frame

    def to_xarray(self) -> XarrayDataset:
        """Return the columns of the export as an xarray.Dataset over t in s, with units.

        Examples
        --------
        >>> table = armrig.example_recording().to_xarray()
        >>> table.sizes["t"], table.attrs["unit_alpha"]
        (3000, 'rad')
        """
        xarray = load_extra("xarray", "xarray")
        columns = export_columns(self)
        about = {name: {"units": unit} for name, unit in _units(self).items()}
        t = columns.pop("t")
        made: XarrayDataset = xarray.Dataset(
            {name: ("t", column, about.get(name, {})) for name, column in columns.items()},
            coords={"t": ("t", t, about["t"])},
            attrs=export_metadata(self),
        )
        return made

    def plot(self, *, ax: Axes | None = None) -> Figure:
        """Return a figure of the first channel and u against time: see `armrig.plots.plot_data`.

        Examples
        --------
        >>> armrig.example_recording().plot()
        <Figure size ... with 2 Axes>
        """
        from armrig.data.figures import plot_data

        return figure_of(plot_data(self, ax=ax))

    _repr_html_ = html

    def __repr__(self) -> str:
        """Describe the recording in one line."""
        parts = [f"{self.manifest.experiment}, {plural(self.N, 'sample')} at {self.Ts:g} s"]
        parts += [f"{self.missing} missing"] if self.missing else []
        parts += [f"{self.hidden} in the dead band or just after"] if self.hidden else []
        parts += [self.damage] if self.truncated else []
        return f"<Recording {self.short_hash}: {'; '.join(parts)}>"


def export_columns(recording: Recording, *, raw: bool = False) -> dict[str, NDArray[Any]]:
    """Return the columns (N,) of an export: k, t, the input, the channels, masks, and present.

    A run under a control law also has r, v and is_limited, the reference, the voltage before the
    limits, NaN without a decision, and whether the voltage was limited. `raw` adds columns of the
    recorded readings and times, with 0 for a missing sample.
    """
    channels = [(c, recording.channel(c.name)) for c in recording.description.channels]
    rig_input = recording.description.input
    columns: dict[str, NDArray[Any]] = {
        "k": recording.k_first + np.arange(recording.N),
        "t": recording.t,
        rig_input.name: rig_input.value(recording.u),
        **{c.name: channel.y for c, channel in channels},
        **{c.valid: channel.valid for c, channel in channels},
        "present": recording.present,
    }
    law = _law_columns(recording)  # a channel of the rig keeps its name
    columns |= {f"law_{name}" if name in columns else name: column for name, column in law.items()}
    counts = (c.counts_field for c, _ in channels)
    names = (*counts, "flags", "t_device_us", "t_host_ns", "t_sched_ns")
    for name in names if raw else ():
        column = np.zeros(recording.N, recording.samples.dtype[name])
        column[recording.present] = recording.samples[name]
        columns[name] = column
    return columns


def _law_columns(recording: Recording) -> dict[str, NDArray[Any]]:
    """Return the columns (N,) of a run under a control law, by name; {} without a law."""
    if recording.decisions is None:
        return {}
    table = recording.decisions()
    row = table["k"].astype(np.int64) - recording.k_first
    inside = (row >= 0) & (row < recording.N)
    v, is_limited = np.full(recording.N, np.nan), np.zeros(recording.N, np.bool_)
    v[row[inside]] = table["v"][inside]
    is_limited[row[inside]] = (table["is_low"] + table["is_high"] + table["is_slewed"])[inside] > 0
    r = {} if recording.r is None else {"r": recording.r}
    return r | {"v": v, "is_limited": is_limited}


def export_metadata(recording: Recording) -> dict[str, str]:
    """Return the units of the columns, Ts, hash and run, as texts."""
    units = {f"unit_{name}": unit for name, unit in _units(recording).items()}
    return {
        **units,
        "Ts": repr(recording.Ts),
        "sha256": recording.sha256,
        "run_id": recording.manifest.run_id,
        "rig": recording.manifest.rig,
    }


def _units(recording: Recording) -> dict[str, str]:
    rig_input, channels = recording.description.input, recording.description.channels
    law = {"v": "V"} if recording.decisions else {}
    return {**law, "t": "s", rig_input.name: rig_input.unit} | {c.name: c.unit for c in channels}
