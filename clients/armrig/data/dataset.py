"""Data of several inputs and outputs, and the view of one input and one output."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any, TypeVar, cast

import numpy as np
from armrig_core.errors import InputError
from armrig_core.process.calls import with_argument_checks
from numpy.typing import ArrayLike

from armrig.data.columns import (
    Intersample,
    Matrix,
    Names,
    as_tuple,
    channel_list,
    columns,
    courses_of,
    index_of,
    interval,
    names_of,
    plain,
    reference_of,
    require_finite,
    require_size,
    sampling,
    starts_of,
    units_of,
    validity,
)
from armrig.data.columns import Vector as Vector
from armrig.data.experiments import Experiments, Trend, replace_unchecked
from armrig.numerics.checks import column
from armrig.numerics.quantities import plural
from armrig.numerics.stretches import Mask

T = TypeVar("T")
VOLTS = (0.0, 1.0)
"""Scale of an input in V: its value at 0 V, and its change per volt."""


@dataclass(frozen=True, slots=True, kw_only=True, init=False, eq=False, repr=False)
class Signals(Experiments):
    """N samples of nu inputs and ny outputs, from one or several experiments.

    A `Dataset` is the view of one input and one output: `signals.dataset("y", "u")` returns the
    Dataset of the output y and the input u. Estimators that take a Dataset also accept Signals
    of one input and one output.

    Parameters
    ----------
    u : array_like, shape (N, nu) or (N,)
        Inputs, one column for each input. The column names of a DataFrame name the inputs.
    y : array_like, shape (N, ny) or (N,)
        Outputs, one column for each output. NaN and masked values are missing.
    Ts : float, optional
        Sampling time in s.
    t : array_like, shape (N,), optional
        Sample times in s, instead of Ts, equidistant within each experiment.
    valid : array_like of bool, shape (N, ny) or (N,), optional
        False where an output is missing.
    starts : sequence of int, default (0,)
        Index of the first sample of each experiment. Estimators never combine samples of two
        experiments in an equation.
    inputs, outputs : sequence of str, optional
        Names of the channels; by default u and y, or u1, u2 … and y1, y2 ….
    input_units, units : sequence of str, optional
        Units of the inputs and of the outputs.
    intersample : {"zoh", "foh"} or sequence of these, default "zoh"
        Course of each input between samples: held, or a straight line. Models in discrete time do
        not use this setting.
    input_scales : sequence of (float, float), optional
        Value of each input at 0 V at a rig's pin, and its change per volt; default: volts.
    source : str
        Hash of the recording or data file; "" for data without a file.
    history : sequence of str
        Steps of the treatment so far, one sentence for each.
    trends : sequence of Trend, default ()
        Means and lines that `detrend` removed from each experiment; `retrend` restores them.
    r : array_like, shape (N,), optional
        Reference of a closed loop, or another signal that excites the loop. Filters and `resample`
        drop r, and no other treatment changes it.

    Raises
    ------
    ValueError
        A shape is wrong, names repeat, an input, r or a valid output is not finite, one of several
        outputs has no valid sample, or the times are not equidistant.

    Examples
    --------
    >>> import numpy as np
    >>> u = np.sign(np.sin(np.arange(200.0)))
    >>> y = np.column_stack([np.cumsum(u), u])
    >>> signals = armrig.Signals(u=u, y=y, Ts=0.01, outputs=["theta_1", "alpha"])
    >>> signals.dataset("alpha").N
    200
    """

    u: Matrix
    y: Matrix
    Ts: float
    """Sampling time in s."""
    valid: Mask
    starts: tuple[int, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    input_units: tuple[str, ...]
    units: tuple[str, ...]
    intersample: tuple[Intersample, ...]
    input_scales: tuple[tuple[float, float], ...]
    """Value of each input at 0 V at a rig's pin, and its change per volt; see `volts`."""
    source: str
    history: tuple[str, ...]
    trends: tuple[Trend, ...]
    r: Vector | None
    """Reference (N,) in the unit of the law that controlled the rig; None without a reference."""

    @with_argument_checks
    def __init__(
        self,
        *,
        u: ArrayLike,
        y: ArrayLike,
        Ts: float | None = None,
        t: ArrayLike | None = None,
        valid: ArrayLike | None = None,
        starts: Sequence[int] = (0,),
        inputs: Names | None = None,
        outputs: Names | None = None,
        input_units: Names | None = None,
        units: Names | None = None,
        intersample: str | Sequence[str] = "zoh",
        input_scales: Sequence[tuple[float, float]] | None = None,
        source: str = "",
        history: Sequence[str] = (),
        trends: Sequence[Trend] = (),
        r: ArrayLike | None = None,
    ) -> None:
        u_, y_ = columns("u", u), columns("y", y)
        (N, nu), ny = u_.shape, y_.shape[1]
        if y_.shape[0] != N:
            raise InputError(
                f"u has {plural(N, 'sample')} and y has {y_.shape[0]}; both need one value for "
                "each instant"
            )
        starts_ = starts_of(starts, N)
        outputs_ = names_of("outputs", outputs, y, "y", ny)
        inputs_ = names_of("inputs", inputs, u, "input" if "u" in outputs_ else "u", nu)
        if both := sorted(set(inputs_) & set(outputs_)):
            raise InputError(
                f"{', '.join(both)}: the name of both an input and an output; each channel needs "
                "its own name"
            )
        valid_ = validity(valid, y_.shape) & ~np.isnan(y_)
        for j, name in enumerate(outputs_):
            mark = "mark them missing, valid=numpy.isfinite(y)"
            require_finite(name, y_[:, j], mark, where=valid_[:, j])
        for j, name in enumerate(inputs_):
            cut_out = "a model needs the input at each instant: cut these samples out"
            require_finite(name, u_[:, j], cut_out)
            require_size(name, u_[:, j])
        for i, name in enumerate(outputs_):
            if ny > 1 and not valid_[:, i].any():
                raise InputError(
                    f"{name} has no valid sample in {N}; leave this output out, or record it again"
                )
            require_size(name or "y", y_[valid_[:, i], i])
        if len(trends) not in (0, len(starts_)):
            raise InputError(
                f"{plural(len(trends), 'trend')} for {plural(len(starts_), 'experiment')}; give "
                "one for each, or none"
            )
        y_[~valid_] = np.nan
        r_ = None if r is None else reference_of(r, N)
        for array in (u_, y_, valid_, *([] if r_ is None else [r_])):
            array.flags.writeable = False
        values = {
            "u": u_,
            "y": y_,
            "Ts": sampling(Ts, t, starts_, N),
            "valid": valid_,
            "starts": starts_,
            "inputs": inputs_,
            "outputs": outputs_,
            "input_units": units_of("input_units", input_units, nu),
            "units": units_of("units", units, ny),
            "intersample": courses_of(intersample, nu),
            "input_scales": tuple(input_scales or nu * [VOLTS]),
            "source": source,
            "history": tuple(history),
            "trends": tuple(
                t.each(lambda x: np.broadcast_to(x, nu), lambda x: np.broadcast_to(x, ny))
                for t in trends
            ),
            "r": r_,
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)  # the fields of a frozen dataclass

    def signals(self) -> Signals:
        """Return the object itself; a Dataset and a recording have the same method.

        Examples
        --------
        >>> signals = armrig.example_recording().signals()
        >>> signals.signals() is signals
        True
        """
        return self

    def _like(self, signals: Signals) -> Signals:
        return signals

    def _values(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in self.__slots__}

    @property
    def nu(self) -> int:
        """Number of inputs."""
        return len(self.inputs)

    @property
    def volts(self) -> Matrix:
        """Inputs (N, nu) in V at the rig's pin; without their means, if a trend was removed.

        Data without a rig, and a rig whose input is in volts, have u itself.

        Examples
        --------
        >>> signals = armrig.Signals(u=[0, 60], y=[0, 1], Ts=1, input_scales=[(0, 20)])
        >>> signals.volts.ravel()
        array([0., 3.])
        """
        offset, per_volt = np.array(self.input_scales).T
        volts: Matrix = (self.u - (0.0 if self.trends else offset)) / per_volt
        return volts

    @property
    def ny(self) -> int:
        """Number of outputs."""
        return len(self.outputs)

    def output(self, name: str | None = None) -> int:
        """Return the index of an output; the name may be left out if there is one output.

        Examples
        --------
        >>> signals = armrig.example_recording().signals()
        >>> signals.outputs, signals.output("alpha")
        (('theta_1', 'alpha'), 1)
        """
        return index_of("output", name, self.outputs)

    def input(self, name: str | None = None) -> int:
        """Return the index of an input; the name may be left out if there is one input.

        Examples
        --------
        >>> signals = armrig.example_recording().signals()
        >>> signals.u[:, signals.input("u")].max().round(1)
        np.float64(4.5)
        """
        return index_of("input", name, self.inputs)

    def dataset(self, output: str | None = None, input: str | None = None) -> Dataset:
        """Return the view of one output and one input as a Dataset; the arrays are shared.

        `output` may be left out if there is one output, and `input` if there is one input.

        Raises
        ------
        ValueError
            A channel does not exist, or a name is left out although there are several channels.

        Examples
        --------
        >>> signals = armrig.example_recording().signals()
        >>> signals.dataset("alpha")
        <Dataset: 3000 samples at 0.01 s; output alpha [rad]>
        """
        if (output is None and self.ny > 1) or (input is None and self.nu > 1):
            raise InputError(
                f"{plural(self.ny, 'output')} ({channel_list(self.outputs)}) and "
                f"{plural(self.nu, 'input')} "
                f"({channel_list(self.inputs)}): choose one of each with "
                "signals.dataset(output, input)"
            )
        i, j = self.output(output), self.input(input)
        pair = replace_unchecked(
            self,
            u=self.u[:, j : j + 1],
            y=self.y[:, i : i + 1],
            valid=self.valid[:, i : i + 1],
            inputs=(self.inputs[j],),
            outputs=(self.outputs[i],),
            input_units=(self.input_units[j],),
            units=(self.units[i],),
            intersample=(self.intersample[j],),
            input_scales=(self.input_scales[j],),
            trends=tuple(t.each(lambda x: x[[j]], lambda x: x[[i]]) for t in self.trends),
        )
        return view(pair)

    def channels(self, outputs: Names | None = None, inputs: Names | None = None) -> Signals:
        """Return only the named outputs and inputs, in the order given; None keeps all.

        Raises
        ------
        ValueError
            There is no such channel, or a name repeats.

        Examples
        --------
        >>> signals = armrig.example_recording().signals()
        >>> signals.channels(outputs="alpha")
        <Signals: 3000 samples at 0.01 s; outputs alpha [rad]; inputs u [V]>
        """
        of_y = [
            self.output(name) for name in as_tuple(self.outputs if outputs is None else outputs)
        ]
        of_u = [self.input(name) for name in as_tuple(self.inputs if inputs is None else inputs)]
        return self.replaced(
            step=None,
            u=self.u[:, of_u],
            y=self.y[:, of_y],
            valid=self.valid[:, of_y],
            inputs=tuple(self.inputs[j] for j in of_u),
            outputs=tuple(self.outputs[i] for i in of_y),
            input_units=tuple(self.input_units[j] for j in of_u),
            units=tuple(self.units[i] for i in of_y),
            intersample=tuple(self.intersample[j] for j in of_u),
            input_scales=tuple(self.input_scales[j] for j in of_u),
            trends=[t.each(lambda x: x[of_u], lambda x: x[of_y]) for t in self.trends],
        )

    def __repr__(self) -> str:
        """Describe the data in one line."""
        outputs, inputs = (
            channel_list(self.outputs, self.units),
            channel_list(self.inputs, self.input_units),
        )
        return self._description(f"outputs {outputs}; inputs {inputs}", "values missing")


def _column(compute: Callable[[Signals], T], doc: str) -> T:
    """Return a property of a Dataset that is computed from its Signals."""
    return cast("T", property(lambda data: compute(data.signals()), doc=doc))


class Dataset(Experiments):
    """N equidistant samples of u and y, from one or several experiments.

    A Dataset is a view of `Signals` with one input and one output, in which u and y have one
    dimension. `signals()` returns these Signals, and `Signals.dataset` returns the view.

    Parameters
    ----------
    u, y : array_like, shape (N,)
        Input and output. The input is held from each instant to the next (zero-order hold), unless
        these are the channels of `Signals` with another `intersample`. NaN and masked values of y
        are missing; u has no missing value.
    Ts : float
        Sampling time in s.
    valid : array_like of bool, shape (N,), optional
        False where y is missing. At these samples `y` is NaN, and every sample computed from one of
        them is NaN.
    output, unit, input_unit, input : str
        Name of y, its unit, the unit of u, and the name of u.
    input_scale : (float, float), optional
        Value of u at 0 V at a rig's pin, and its change per volt; default: volts.
    starts, source, history, trends, r
        As for `Signals`.

    Raises
    ------
    ValueError
        The lengths differ, u or y is complex, u is masked or not finite, a valid y is infinite, or
        Ts is not > 0.

    Examples
    --------
    >>> import numpy as np
    >>> data = armrig.Dataset(u=[1, 1, 4, 4], y=[0.1, 0.1, 0.2, np.nan], Ts=0.01,
    ...                       output="alpha", unit="rad")
    >>> data
    <Dataset: 4 samples at 0.01 s; output alpha [rad]; 1 missing (25.0 %)>
    """

    __slots__ = ("_columns",)
    _columns: Signals

    @with_argument_checks
    def __init__(
        self,
        *,
        u: ArrayLike,
        y: ArrayLike,
        Ts: float,
        valid: ArrayLike | None = None,
        starts: Sequence[int] = (0,),
        output: str = "y",
        unit: str = "",
        input_unit: str = "V",
        input: str = "",
        input_scale: tuple[float, float] | None = None,
        source: str = "",
        history: Sequence[str] = (),
        trends: Sequence[Trend] = (),
        r: ArrayLike | None = None,
    ) -> None:
        y = plain("y", y)
        u_, y_ = column("u", plain("u", u)), column("y", y)
        valid_ = validity(valid, y_.shape) & ~np.isnan(y_)
        valid_ &= ~np.ma.getmaskarray(np.ma.asanyarray(y))
        require_finite("y", y_, "mark them missing, valid=numpy.isfinite(y)", where=valid_)
        self._columns = Signals(
            u=u_,
            y=y_,
            Ts=interval(Ts),
            valid=valid_,
            starts=starts,
            outputs=[output],
            units=[unit],
            inputs=[input] if input else None,
            input_units=[input_unit],
            input_scales=[input_scale or VOLTS],
            source=source,
            history=history,
            trends=trends,
            r=r,
        )

    def signals(self) -> Signals:
        """Return the data as Signals with one input, u, and one output; the arrays are shared.

        Examples
        --------
        >>> armrig.example_recording().dataset("alpha").signals()
        <Signals: 3000 samples at 0.01 s; outputs alpha [rad]; inputs u [V]>
        """
        return self._columns

    def _like(self, signals: Signals) -> Dataset:
        return view(signals)

    def _values(self) -> dict[str, Any]:
        names = ("u", "y", "Ts", "valid", "starts", "output", "unit", "input_unit", "input")
        more = ("input_scale", "source", "history", "trends", "r")
        return {name: getattr(self, name) for name in (*names, *more)}

    u = _column(lambda data: data.u[:, 0], "Input (N,), in `input_unit`.")
    y = _column(lambda data: data.y[:, 0], "Output (N,), in `unit`; NaN where it is missing.")
    valid = _column(lambda data: data.valid[:, 0], "Mask (N,), False where y is missing.")
    Ts = _column(lambda data: data.Ts, "Sampling time, in s.")
    starts = _column(lambda data: data.starts, "Index of the first sample of each experiment.")
    output = _column(lambda data: data.outputs[0], "Name of y.")
    unit = _column(lambda data: data.units[0], "Unit of y.")
    input_unit = _column(lambda data: data.input_units[0], "Unit of u.")
    input = _column(lambda data: data.inputs[0], "Name of u.")
    input_scale = _column(
        lambda data: data.input_scales[0], "Value of u at 0 V at the pin, and its change per volt."
    )
    source = _column(lambda data: data.source, 'Hash of the recording or data file, or "".')
    history = _column(lambda data: data.history, "Steps of the treatment, a sentence for each.")
    trends = _column(
        lambda data: tuple(t.each(np.ndarray.item, np.ndarray.item) for t in data.trends),
        "Trend removed from each experiment; () if there is no trend that can be restored.",
    )

    r = _column(
        lambda data: data.r, "Reference (N,) of a closed loop, or None; not part of `digest`."
    )

    def origin(self) -> dict[str, Any]:
        """Return the facts about the data that a `Fit` stores, such as units and history.

        Examples
        --------
        >>> origin = armrig.example_recording().dataset("alpha").origin()
        >>> origin["output"], origin["unit"], origin["input_unit"]
        ('alpha', 'rad', 'V')
        """
        names = ("output", "unit", "input_unit", "source", "history", "digest")
        return {name: getattr(self, name) for name in names}

    def __repr__(self) -> str:
        """Describe the data in one line."""
        unit = f" [{self.unit}]" if self.unit else ""
        return self._description(f"output {self.output}{unit}", "missing")


@dataclass(frozen=True, slots=True, kw_only=True)
class OfDataset:
    """Sampling time, names and source of the data of a result."""

    Ts: float
    """Sampling time, in s."""
    output: str
    """Name of y."""
    unit: str
    """Unit of y."""
    input_unit: str
    """Unit of u."""
    source: str
    """Hash of the recording, or ""."""


def labels(source: Any) -> dict[str, Any]:
    """Return the fields of `OfDataset`, of data or of a result."""
    return {field.name: getattr(source, field.name) for field in fields(OfDataset)}


def view(signals: Signals) -> Dataset:
    """Return the view of equidistant Signals with one input and one output."""
    data = object.__new__(Dataset)
    object.__setattr__(data, "_columns", signals)
    return data
