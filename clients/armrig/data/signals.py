"""Data with several inputs and outputs: signals, names, units and missing samples."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from armrig_core.calls import checked_call
from armrig_core.errors import InputError
from numpy.typing import ArrayLike, NDArray

from armrig.data.dataset import Dataset, require_finite, require_size, starts_of
from armrig.data.experiments import Experiments, merged
from armrig.data.pandas_columns import is_pandas, plain
from armrig.data.step import Step, codes_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Mask = NDArray[np.bool_]
Intersample = Literal["zoh", "foh"]
Names = str | Sequence[str]

_MAX_INTERVAL_DEVIATION = 1e-3
"""Largest deviation of an interval of equidistant times, as a share of the mean interval."""
_MAX_SHOWN = 12  # names in a message
_CUT_OUT = "a model needs each input at each instant: cut these samples out"


@dataclass(frozen=True, slots=True, kw_only=True, init=False, eq=False, repr=False)
class Signals(Experiments):
    """N samples of nu inputs and ny outputs, from one or several experiments.

    A `Dataset` has one input and one output: `signals.dataset("alpha", "u")` returns the Dataset of
    the output alpha and the input u. Estimators that take a Dataset also accept Signals of one
    input and one output.

    Parameters
    ----------
    u : array_like, shape (N, nu) or (N,)
        Inputs, one column for each input. The column names of a DataFrame name the inputs.
    y : array_like, shape (N, ny) or (N,)
        Outputs, one column for each output. NaN and masked values are missing.
    Ts : float, optional
        Sampling time in s.
    t : array_like, shape (N,), optional
        Sample times in s, instead of Ts. The times increase within each experiment. If the times
        are equidistant, Ts is their interval.
    valid : array_like of bool, shape (N, ny) or (N,), optional
        False where an output is missing.
    starts : sequence of int, default (0,)
        Index of the first sample of each experiment.
    inputs, outputs : sequence of str, optional
        Names of the channels; by default u and y, or u1, u2 … and y1, y2 ….
    input_units, units : sequence of str, optional
        Units of the inputs and of the outputs.
    intersample : {"zoh", "foh"} or sequence of these, default "zoh"
        Course of each input between samples: held, or a straight line. Models in discrete time do
        not use this setting.
    source : str
        Hash of the recording or data file; "" for data without a file.
    history : sequence of str
        Steps of the treatment so far, one sentence for each.

    Raises
    ------
    ValueError
        A shape is wrong, names repeat, an input is not finite, or an output has no valid sample.

    Examples
    --------
    >>> import numpy as np, armrig
    >>> u = np.sign(np.sin(np.arange(200.0)))
    >>> y = np.column_stack([np.cumsum(u), u])
    >>> signals = armrig.Signals(u=u, y=y, Ts=0.01, outputs=["theta_1", "alpha"])
    >>> signals.dataset("alpha").N
    200
    """

    u: Matrix
    """Inputs (N, nu)."""
    y: Matrix
    """Outputs (N, ny); NaN where an output is missing."""
    Ts: float | None
    """Sampling time in s; None if the times are not equidistant."""
    times: Vector | None
    """Sample times (N,) in s; None if the times are equidistant."""
    valid: Mask
    """Mask (N, ny), False where an output is missing."""
    starts: tuple[int, ...]
    """Index of the first sample of each experiment."""
    inputs: tuple[str, ...]
    """Names of the inputs."""
    outputs: tuple[str, ...]
    """Names of the outputs."""
    input_units: tuple[str, ...]
    """Units of the inputs."""
    units: tuple[str, ...]
    """Units of the outputs."""
    intersample: tuple[Intersample, ...]
    """Course of each input between samples: "zoh" (held) or "foh" (a straight line)."""
    source: str
    """Hash of the recording or data file; "" for data without a file."""
    history: tuple[str, ...]
    """Steps of the treatment, first to last, one sentence for each."""

    @checked_call
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
        source: str = "",
        history: Sequence[str] = (),
    ) -> None:
        inputs, outputs = _given_names(u, inputs), _given_names(y, outputs)
        u_, y_ = _columns("u", u), _columns("y", y)
        N = u_.shape[0]
        if y_.shape[0] != N:
            raise InputError(
                f"u has {N} samples and y has {y_.shape[0]}; both need a row for each instant"
            )
        starts_ = starts_of(starts, N)
        Ts_, times = _sampling(Ts, t, starts_, N)
        inputs_ = _names("inputs", inputs, "u", u_.shape[1])
        outputs_ = _names("outputs", outputs, "y", y_.shape[1])
        if both := sorted(set(inputs_) & set(outputs_)):
            raise InputError(
                f"{', '.join(both)}: the name of both an input and an output; each channel needs "
                "its own name"
            )
        valid_ = np.isfinite(y_) & _validity(valid, y_.shape)
        for j, name in enumerate(inputs_):
            require_finite(f"input {name}", u_[:, j], _CUT_OUT)
            require_size(name, u_[:, j])
        for i, name in enumerate(outputs_):
            if not valid_[:, i].any():
                raise InputError(
                    f"{name} has no valid sample in {N}; leave this output out, or record it again"
                )
            require_size(name, y_[valid_[:, i], i])
        y_[~valid_] = np.nan
        arrays = [u_, y_, valid_, *(() if times is None else (times,))]
        for array in arrays:
            array.flags.writeable = False
        values = {
            "u": u_,
            "y": y_,
            "Ts": Ts_,
            "times": times,
            "valid": valid_,
            "starts": starts_,
            "inputs": inputs_,
            "outputs": outputs_,
            "input_units": _units("input_units", input_units, len(inputs_)),
            "units": _units("units", units, len(outputs_)),
            "intersample": _courses(intersample, len(inputs_)),
            "source": source,
            "history": tuple(history),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)  # the fields of a frozen dataclass

    @property
    def nu(self) -> int:
        """Number of inputs."""
        return len(self.inputs)

    @property
    def ny(self) -> int:
        """Number of outputs."""
        return len(self.outputs)

    @property
    def t(self) -> Vector:
        """Sample times (N,) in s; equidistant times begin at 0."""
        if self.times is not None:
            return self.times
        return self.equidistant() * np.arange(self.N, dtype=np.float64)

    @property
    def digest(self) -> str:
        """Hash of the samples and starts, to distinguish estimation and validation data."""
        arrays = (self.u, self.y, self.valid, self.t, np.array(self.starts))
        return hashlib.blake2b(b"".join(x.tobytes() for x in arrays), digest_size=8).hexdigest()

    def equidistant(self) -> float:
        """Return Ts in s, or refuse times that are not equidistant.

        Examples
        --------
        >>> import armrig
        >>> armrig.example_recording().signals().equidistant()
        0.01
        """
        if self.Ts is None:
            raise InputError(
                "the sample times are not equidistant, which a model in discrete time needs; "
                "interpolate the signals to equidistant times first"
            )
        return self.Ts

    def output(self, name: str | None = None) -> int:
        """Return the index of an output; the name may be left out if there is one output.

        Examples
        --------
        >>> import armrig
        >>> signals = armrig.example_recording().signals()
        >>> signals.outputs, signals.output("alpha")
        (('theta_1', 'alpha'), 1)
        """
        return _index("output", name, self.outputs)

    def input(self, name: str | None = None) -> int:
        """Return the index of an input; the name may be left out if there is one input.

        Examples
        --------
        >>> import armrig
        >>> signals = armrig.example_recording().signals()
        >>> signals.u[:, signals.input("u")].max().round(1)
        np.float64(4.5)
        """
        return _index("input", name, self.inputs)

    def dataset(self, output: str | None = None, input: str | None = None) -> Dataset:
        """Return the Dataset of one output and one input.

        `output` may be left out if there is one output, and `input` if there is one input.

        Raises
        ------
        ValueError
            A channel does not exist, a name is left out although there are several channels, or the
            times are not equidistant.

        Examples
        --------
        >>> import armrig
        >>> signals = armrig.example_recording().signals()
        >>> signals.dataset("alpha")
        <Dataset: 3000 samples at 0.01 s; output alpha [rad]>
        """
        if (output is None and self.ny > 1) or (input is None and self.nu > 1):
            raise InputError(
                f"{self.ny} outputs ({_listed(self.outputs)}) and {self.nu} inputs "
                f"({_listed(self.inputs)}): choose one of each with signals.dataset(output, input)"
            )
        i, j = self.output(output), self.input(input)
        return Dataset(
            u=self.u[:, j],
            y=self.y[:, i],
            Ts=self.equidistant(),
            valid=self.valid[:, i],
            starts=self.starts,
            output=self.outputs[i],
            unit=self.units[i],
            input_unit=self.input_units[j],
            source=self.source,
            history=self.history,
        )

    def channels(self, outputs: Names | None = None, inputs: Names | None = None) -> Signals:
        """Return only the named outputs and inputs, in the order given; None keeps all.

        Raises
        ------
        ValueError
            There is no such channel, or a name repeats.

        Examples
        --------
        >>> import armrig
        >>> signals = armrig.example_recording().signals()
        >>> signals.channels(outputs="alpha")
        <Signals: 3000 samples at 0.01 s; outputs alpha [rad]; inputs u [V]>
        """
        of_y = [self.output(name) for name in _sequence(self.outputs, outputs)]
        of_u = [self.input(name) for name in _sequence(self.inputs, inputs)]
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
        )

    def _rest_between(self, a: int, b: int) -> dict[str, Any]:
        return {"times": None if self.times is None else self.times[a:b]}

    def treated(
        self, treatment: Callable[[Dataset], Dataset], channels: Names | None = None
    ) -> Signals:
        """Return the signals after a treatment, which is applied channel by channel.

        Parameters
        ----------
        treatment : callable
            Function of a Dataset that treats u and y independently of each other.
        channels : str or sequence of str, optional
            Channels to treat; by default all of them.

        Raises
        ------
        ValueError
            There is no such channel, or `channels` is given and the treatment changes the sampling
            time or the number of samples.

        Examples
        --------
        The mean of alpha is removed; theta_1 integrates and keeps its level.

        >>> import armrig
        >>> signals = armrig.example_recording().signals()
        >>> treated = signals.treated(armrig.detrend, "alpha")
        >>> treated.history
        ('removed the mean from u and y (order 0) (alpha only)',)
        >>> abs(treated.dataset("alpha").y.mean()) < 1e-12
        np.True_
        """
        named = set((*self.outputs, *self.inputs) if channels is None else _tuple(channels))
        if unknown := sorted(named - {*self.outputs, *self.inputs}):
            raise InputError(
                f"{', '.join(unknown)}: there is no such channel; there are "
                f"{_listed((*self.outputs, *self.inputs))}"
            )
        pairs = [(min(k, self.ny - 1), min(k, self.nu - 1)) for k in range(max(self.ny, self.nu))]
        found = [treatment(self.dataset(self.outputs[i], self.inputs[j])) for i, j in pairs]
        first = found[0]
        if channels is not None and (first.Ts, first.N) != (self.Ts, self.N):
            raise InputError(
                "the treatment changes the sampling time or the number of samples, so it must be "
                "applied to all channels: leave out `channels`"
            )
        u, y, valid = (
            np.array(np.column_stack(x), order="F")
            for x in (
                [found[j].u if c in named else self.u[:, j] for j, c in enumerate(self.inputs)],
                [found[i].y if c in named else self.y[:, i] for i, c in enumerate(self.outputs)],
                [
                    found[i].valid if c in named else self.valid[:, i]
                    for i, c in enumerate(self.outputs)
                ],
            )
        )
        at = [i if c in named else None for i, c in enumerate(self.outputs)]
        only = "" if channels is None else f" ({_listed(sorted(named))} only)"
        each = [data.history[len(self.history) :] for data in found]
        steps = [
            Step(f"{'' if len(set(each)) == 1 else f'{data.output}: '}{step}{only}", code)
            for data, new in zip(found, each, strict=True)
            for step, code in zip(new, codes_of(new), strict=True)
        ]
        return self.replaced(
            step=None,
            u=u,
            y=y,
            valid=valid,
            Ts=first.Ts,
            starts=first.starts,
            outputs=tuple(
                self.outputs[i] if k is None else found[k].output for i, k in enumerate(at)
            ),
            units=tuple(self.units[i] if k is None else found[k].unit for i, k in enumerate(at)),
            history=(*self.history, *dict.fromkeys(steps)),
        )

    def plot(self, *, ax: Axes | None = None) -> Figure:
        """Return a figure of all outputs and inputs against time.

        Examples
        --------
        >>> import armrig
        >>> armrig.example_recording().signals().plot()
        <Figure size ... with 3 Axes>
        """
        from armrig.data.signal_figures import plot_signals
        from armrig.plots.layout import figure_of

        return figure_of(plot_signals(self, ax=ax))

    def __repr__(self) -> str:
        """Describe the data in one line."""
        rate = "unequal intervals" if self.Ts is None else f"{self.Ts:g} s"
        parts = [
            f"{self.N} samples at {rate}",
            f"outputs {_listed(self.outputs, self.units)}",
            f"inputs {_listed(self.inputs, self.input_units)}",
        ]
        if self.missing:
            parts.append(
                f"{self.missing} values missing ({100 * self.missing / self.y.size:.1f} %)"
            )
        if len(self.starts) > 1:
            parts.append(f"{len(self.starts)} experiments")
        if self.history:
            parts.append(f"history: {'; '.join(self.history)}")
        return f"<Signals: {'; '.join(parts)}>"


def merged_signals(parts: Sequence[Signals]) -> Signals:
    """Return several experiments as one Signals object; `armrig.merge` documents it."""
    known = [d.times for d in parts if d.times is not None]
    return merged(parts, times=np.concatenate(known) if known else None)


def _tuple(names: Names) -> tuple[str, ...]:
    return (names,) if isinstance(names, str) else tuple(names)


def _sequence(all_names: tuple[str, ...], chosen: Names | None) -> tuple[str, ...]:
    return all_names if chosen is None else _tuple(chosen)


def _listed(names: Sequence[str], units: Sequence[str] = ()) -> str:
    """Return names with their units as text; a long list is cut off."""
    pairs = zip(names, units or [""] * len(names), strict=True)
    texts = [f"{name} [{unit}]" if unit else name for name, unit in pairs]
    return ", ".join(texts[:_MAX_SHOWN]) + (", …" if len(texts) > _MAX_SHOWN else "")


def _index(what: str, name: str | None, names: tuple[str, ...]) -> int:
    if name is None and len(names) == 1:
        return 0
    if name not in names:
        said = f"{what}={name!r}: there is no such {what}" if name else f"which {what}?"
        raise InputError(f"{said}; there are {_listed(names)}")
    return names.index(name)


def _given_names(values: Any, names: Names | None) -> Names | None:
    """Return `names`; if it is None, return the column names of a DataFrame."""
    columns = getattr(values, "columns", None)
    if names is not None or not is_pandas(values) or columns is None:
        return names
    return [str(name) for name in columns]


def _columns(name: str, values: Any) -> Matrix:
    """Return a column-major copy (N, n) of the values, with NaN for masked values."""
    if getattr(values, "ndim", 1) == 2 and is_pandas(values):
        values = np.column_stack([plain(name, values.iloc[:, j]) for j in range(values.shape[1])])
    given = np.ma.asanyarray(plain(name, values))
    if given.dtype.kind not in "buif":
        raise InputError(
            f"{name} is an array of {given.dtype}; give real numbers, a column for each channel"
        )
    taken = np.array(np.ma.filled(given.astype(np.float64), np.nan), order="F")
    if taken.ndim == 1:
        taken = taken[:, None]
    if taken.ndim != 2 or 0 in taken.shape:
        raise InputError(
            f"{name} has shape {taken.shape}; give (N, n), a row for each instant and a column for "
            "each channel"
        )
    if taken.shape[1] > taken.shape[0]:
        raise InputError(
            f"{name} has {taken.shape[0]} rows and {taken.shape[1]} columns, fewer samples than "
            f"channels; give {name}.T if the channels are the rows"
        )
    return taken


def _names(what: str, names: Names | None, letter: str, n: int) -> tuple[str, ...]:
    if names is None:
        return (letter,) if n == 1 else tuple(f"{letter}{k + 1}" for k in range(n))
    given = _tuple(names)
    if len(given) != n or not all(isinstance(name, str) and name for name in given):
        raise InputError(
            f"{what}={list(given)!r}: {n} names are needed, one for each column of {letter}"
        )
    if repeated := sorted({name for name in given if given.count(name) > 1}):
        raise InputError(f"{what}: {', '.join(repeated)} repeats; each channel needs its own name")
    return given


def _units(what: str, units: Names | None, n: int) -> tuple[str, ...]:
    given = ("",) * n if units is None else _tuple(units)
    if len(given) != n:
        raise InputError(
            f'{what}={list(given)!r}: {n} units are needed, one for each channel; "" is none'
        )
    return given


def _courses(intersample: str | Sequence[str], n: int) -> tuple[Intersample, ...]:
    given = (intersample,) * n if isinstance(intersample, str) else tuple(intersample)
    allowed = get_args(Intersample)
    if len(given) != n or not set(given) <= set(allowed):
        raise InputError(
            f'intersample={intersample!r} must be "zoh" or "foh", or one of these for each of the '
            f"{n} inputs"
        )
    return tuple(allowed[allowed.index(course)] for course in given)


def _validity(valid: Any, shape: tuple[int, ...]) -> Mask:
    if valid is None:
        return np.ones(shape, dtype=np.bool_)
    if is_pandas(valid):
        valid = valid.to_numpy(dtype=np.bool_, na_value=False)
    given = np.array(np.ma.filled(np.ma.asanyarray(valid), False), dtype=np.bool_)
    if given.ndim == 1:
        given = given[:, None]
    if given.shape != shape:
        raise InputError(f"valid has shape {given.shape}, y has {shape}; give one bool per value")
    return given


def _sampling(
    Ts: Any, t: ArrayLike | None, starts: tuple[int, ...], N: int
) -> tuple[float | None, Vector | None]:
    """Return (Ts, None) for equidistant samples, and (None, times) for other samples."""
    if (Ts is None) == (t is None):
        raise InputError("give either Ts, the sampling time in s, or t, the time of each sample")
    if t is None:
        if isinstance(Ts, str) or np.ndim(Ts) or not (isfinite(Ts) and Ts > 0):
            raise InputError(f"Ts={Ts!r} must be one finite number > 0, in s")
        return float(Ts), None
    times = np.array(plain("t", t), dtype=np.float64)
    if times.shape != (N,) or not np.isfinite(times).all():
        raise InputError(f"t has shape {times.shape}; give {N} finite times, one for each sample")
    edges = zip(starts, (*starts[1:], N), strict=True)
    intervals = np.concatenate([np.diff(times[a:b]) for a, b in edges])
    if not intervals.size or not (intervals > 0).all():
        raise InputError("t must rise from each sample of an experiment to the next")
    mean = float(np.mean(intervals))
    if np.max(np.abs(intervals - mean)) <= _MAX_INTERVAL_DEVIATION * mean:
        return mean, None
    return None, times
