"""A recording: what the rig did in one run, on a complete grid of samples."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from armrig_core import telemetry
from armrig_core.calibration import Calibration
from armrig_core.errors import FileError, InputError
from armrig_core.manifest import Manifest, Outcome, Recovered
from armrig_core.telemetry import THETA_1, OutputName
from numpy.typing import NDArray

from armrig.data.dataset import Dataset
from armrig.data.treatment import difference
from armrig.numerics.stretches import Mask
from armrig.recordings.daemon_reports import DeviceClock, Event, Gap, Note, Timing

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame
    from xarray import Dataset as XarrayDataset

Vector = NDArray[np.float64]


class Channel(NamedTuple):
    """What a recording shows of a channel of the rig."""

    y: Vector
    """In the channel's unit, (N,); NaN where it is not valid."""
    valid: Mask


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Recording:
    """What the rig did in one run; row i of every array is the sample `k_first` + i.

    The grid is complete, from the first sample that was due to the last: where a sample is missing
    its row is there, with `theta_1` and `alpha` NaN, so that no formula can use it unseen.
    """

    path: Path
    """Where it was read from."""
    sha256: str
    """Hash of the file, all of it."""
    manifest: Manifest
    """How the run was made."""
    outcome: Outcome | None
    """How the run ended, which a file may tell before its own end; None where it does not."""
    recovered: Recovered | None
    """How the file was completed after its daemon had died; None where that was not needed."""
    calibration: Calibration | None
    """Counts to angles, codes to volts; None where it is missing: the daemon's are used then.

    It was applied to the counts and codes when the recording was read; `made` says how it was made.
    """
    k_first: int
    """Index of the first row; older files begin with their first sample that came."""
    t: Vector
    """Time in s from the first sample that was due, (N,)."""
    u: Vector
    """Voltage in V at the motor's terminals from `t` on, (N,): what the device held, calibrated.

    Where a sample is missing: what its gap record says was held; NaN without a record.
    """
    theta_1: Vector
    """Angle of the chassis in rad with its turns counted, (N,); NaN where it is not `valid`."""
    alpha: Vector
    """Angle of the arm against the chassis in rad, (N,); NaN where it is not `valid_alpha`."""
    valid: Mask
    """(N,): False for theta_1 in the dead band, at the first sample after it, and where missing."""
    valid_alpha: Mask
    """(N,): False for alpha at a rail and where the sample is missing.

    The dead band of theta_1 does not matter to it; and as alpha does not turn on, the sample after
    a rail is as good as any.
    """
    others: Mapping[str, Channel]
    """Channels of `armrig_core.telemetry.CHANNELS` besides these two, by name; today none."""
    present: Mask
    """(N,): the sample came."""
    turns_unknown: tuple[int, ...]
    """Rows from which on theta_1 may be wrong by whole turns: samples were missing for too long."""
    samples: NDArray[np.void]
    """The samples as recorded, raw counts and all times, a structured array of those that came."""
    gaps: tuple[Gap, ...]
    """Missing samples, as the daemon recorded them."""
    events: tuple[Event, ...]
    """What the daemon had to say."""
    notes: tuple[Note, ...]
    """What people wrote during the run."""
    timing: tuple[Timing, ...]
    """Timing, once a second."""
    clock: tuple[DeviceClock, ...]
    """The device's clock against the host's, once a second."""
    truncated: bool
    """The file is not whole: see `damage`."""
    cut_off: bool
    """It ends too early, and nothing before its end is wrong."""
    damage: str
    """What is wrong with the file and how much was saved; "" for a whole one."""

    @property
    def N(self) -> int:
        """Number of samples, missing ones included."""
        return int(self.t.size)

    @property
    def Ts(self) -> float:
        """Sampling time, in s."""
        return self.manifest.Ts

    @property
    def asked_s(self) -> float:
        """Length of the input that was asked for, in s."""
        return max(self.manifest.samples, 0) * self.Ts

    @property
    def missing(self) -> int:
        """Number of samples that did not come, as far as the file goes."""
        return self.N - int(self.samples.size)

    @property
    def hidden(self) -> int:
        """Number of samples that came and show no theta_1: in the dead band, and just after it."""
        return int(np.count_nonzero(self.present & ~self.valid))

    @property
    def short_hash(self) -> str:
        """First twelve digits of the hash, as figures carry it."""
        return self.sha256[:12]

    def channel(self, name: str) -> Channel:
        """Return what it shows of a channel of the rig, such as "alpha"."""
        if name in self.others:
            return self.others[name]
        (valid,) = (c.valid for c in telemetry.CHANNELS if c.name == name)
        return Channel(getattr(self, name), getattr(self, valid))

    def dataset(self, output: OutputName = THETA_1) -> Dataset:
        """Return u and one output to identify from, with what is missing marked.

        A sample whose input is not known is left out, and after it, as where the number of turns
        is not known, a new experiment begins.

        Parameters
        ----------
        output : {"theta_1", "alpha", "velocity"}
            The angle of the chassis, that of the arm, or the rate of the first from differences.

        Raises
        ------
        FileError
            There is no valid sample, or no such output.
        """
        outputs = {c.name: c for c in telemetry.CHANNELS}
        outputs |= {c.rate: c for c in telemetry.CHANNELS if c.rate}
        if output not in outputs:
            raise InputError(f"output={output!r}: a recording has {', '.join(outputs)}")
        measured = outputs[output]
        y, valid = self.channel(measured.name)
        known = np.isfinite(self.u)
        if not (valid & known).any():
            raise FileError(
                f"{self.path}: none of its {self.N} samples shows {output}; record again"
            )
        begins = ~known
        begins[1:] = ~known[:-1]
        begins[:1] = True
        if measured.turns:
            begins[list(self.turns_unknown)] = True
        data = Dataset(
            u=self.u[known],
            y=y[known],
            Ts=self.Ts,
            valid=valid[known],
            starts=np.flatnonzero(begins[known]).tolist() or [0],
            output=measured.name,
            unit=measured.unit,
            source=self.sha256,
        )
        return difference(data) if output == measured.rate else data

    def to_pandas(self) -> DataFrame:
        """Return u, theta_1, alpha and where they are valid, a row for each sample, by time in s.

        Raises
        ------
        ImportError
            pandas is not installed.
        """
        from armrig.recordings.export import to_pandas

        return to_pandas(self)

    def to_xarray(self) -> XarrayDataset:
        """Return the same as an xarray.Dataset over t, with units; raises as `to_pandas`."""
        from armrig.recordings.export import to_xarray

        return to_xarray(self)

    def plot(self, *, ax: Axes | None = None) -> Figure:
        """Return a figure of theta_1 and u against time: see `armrig.plots.plot_data`."""
        from armrig.data.figures import plot_data
        from armrig.plots.layout import figure_of

        return figure_of(plot_data(self, ax=ax))

    def _repr_html_(self) -> str:
        """Show itself in a notebook: what it says, and its figure."""
        from armrig.plots.notebook import html

        return html(self)

    def __repr__(self) -> str:
        """Say it in a line."""
        parts = [f"{self.manifest.experiment}, {self.N} samples at {self.Ts:g} s"]
        parts += [f"{self.missing} missing"] if self.missing else []
        parts += [f"{self.hidden} in the dead band or just after"] if self.hidden else []
        parts += [self.damage] if self.truncated else []
        return f"<Recording {self.short_hash}: {'; '.join(parts)}>"
