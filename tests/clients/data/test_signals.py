"""Data with several inputs and outputs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import armrig
import numpy as np
import pandas as pd
import pytest
from armrig import Signals
from armrig.data.step import codes_of, span_of
from armrig_core.errors import FileError, InputError, InputTypeError
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.signal import lfilter

N = 600


def driven(seed: int = 1, missing: float = 0.0, shape: tuple[int, int] = (2, 3)) -> Signals:
    """Return data of a plant with two inputs and three outputs, or the first of these."""
    rng = np.random.default_rng(seed)
    u = np.repeat(np.sign(rng.standard_normal((N // 5, 2))), 5, axis=0)
    y = np.column_stack(
        [
            lfilter([0, 1.0, 0.5], [1, -1.5, 0.7], u[:, 0]) + lfilter([0, 2.0], [1, -0.9], u[:, 1]),
            lfilter([0, 1.0], [1, -0.8], u[:, 1]),
            lfilter([0, 0, 0.3], [1, -0.5], u[:, 0]),
        ]
    )
    y += 0.1 * rng.standard_normal(y.shape) + 3.0
    nu, ny = shape
    return Signals(
        u=u[:, :nu],
        y=y[:, :ny],
        Ts=0.1,
        valid=(rng.random(y.shape) >= missing)[:, :ny],
        starts=(0, 200),
        inputs=["heater", "valve"][:nu],
        outputs=["temperature", "flow", "level"][:ny],
        units=["K", "l/s", "m"][:ny],
        input_units=["V", "%"][:nu],
        source="ab" * 32,
        history=["made"],
    )


SHAPES = pytest.mark.parametrize("shape", [(1, 1), (2, 1), (2, 2)], ids=str)


def test_a_pair_is_the_dataset_of_these_columns() -> None:
    signals = driven(missing=0.1)

    data = signals.dataset("flow", "valve")

    np.testing.assert_array_equal(data.u, signals.u[:, 1])
    np.testing.assert_array_equal(data.y, signals.y[:, 1])
    np.testing.assert_array_equal(data.valid, signals.valid[:, 1])
    assert (data.output, data.unit, data.input_unit) == ("flow", "l/s", "%")
    assert (data.Ts, data.starts, data.source) == (0.1, (0, 200), "ab" * 32)
    assert data.history == ("made",)
    assert 0 < signals.missing == signals.y.size - np.isfinite(signals.y).sum()


@pytest.mark.parametrize("column", [False, True])
def test_one_signal_may_be_a_vector_or_a_column(column: bool) -> None:
    u, y = np.sign(np.sin(np.arange(300.0))), np.arange(300.0) % 7
    wide = (u[:, None], y[:, None]) if column else (u, y)

    signals = Signals(u=wide[0], y=wide[1], Ts=0.1)

    assert (signals.inputs, signals.outputs) == (("u",), ("y",))
    data = armrig.Dataset(u=u, y=y, Ts=0.1)
    np.testing.assert_array_equal(
        armrig.arx(signals, na=2, nb=2).theta, armrig.arx(data, na=2, nb=2).theta
    )


def test_a_data_frame_names_the_channels_and_its_missing_values() -> None:
    frame = pd.DataFrame({"u1": [0.0, 1, 0, 1], "u2": [1.0, 1, 0, 0], "y1": [1.0, None, 2, 3]})

    signals = Signals(u=frame[["u1", "u2"]], y=frame[["y1"]], Ts=0.5)

    assert (signals.inputs, signals.outputs) == (("u1", "u2"), ("y1",))
    assert signals.valid[:, 0].tolist() == [True, False, True, True]


def test_equidistant_times_become_a_sampling_time() -> None:
    t = 3.0 + 0.25 * np.arange(40)
    even = Signals(u=np.ones(40), y=np.ones(40), t=t)
    assert even.Ts == 0.25
    np.testing.assert_allclose(even.t, t - 3.0)

    t[20:] += 0.1
    with pytest.raises(InputError, match="not equidistant"):
        Signals(u=np.ones(40), y=np.ones(40), t=t)
    parts = Signals(u=np.ones(40), y=np.ones(40), t=t, starts=(0, 20))
    assert parts.Ts == pytest.approx(0.25)  # only the gap between the experiments is longer


@SHAPES
def test_the_digest_depends_on_every_number_and_on_no_name(shape: tuple[int, int]) -> None:
    """It distinguishes estimation and validation data."""
    signals = driven(missing=0.1, shape=shape)
    u, y = signals.u.copy(), signals.y.copy()
    u[5, -1] += 1
    y[np.flatnonzero(signals.valid[:, -1])[0], -1] += 1
    others = [
        *(signals.replaced(step=None, **{name: x}) for name, x in (("u", u), ("y", y))),
        signals.replaced(step=None, valid=signals.valid & (np.arange(600) != 77)[:, None]),
        signals.replaced(step=None, starts=(0, 201)),
        signals.replaced(step=None, Ts=0.2),
    ]

    assert len({signals.digest, *(other.digest for other in others)}) == 6
    assert signals.replaced(step="renamed", source="").digest == signals.digest


def test_a_dataset_and_its_columns_share_arrays_and_digest() -> None:
    signals = driven(missing=0.1).channels("flow", "valve")

    data = signals.dataset()

    for name in ("u", "y", "valid"):
        assert np.shares_memory(getattr(data, name), getattr(signals, name))
    assert data.digest == signals.digest == data.origin()["digest"]
    assert data.replaced(step="renamed", output="alpha", unit="rad").digest == data.digest
    assert data.signals().dataset().signals().outputs == ("flow",)


def test_a_part_in_which_an_output_is_missing_is_a_part_of_the_data() -> None:
    signals = driven()
    valid = signals.valid.copy()
    valid[:200, 1] = False

    first, second = signals.replaced(step=None, valid=valid).experiments()

    assert (first.missing, second.missing) == (200, 0)
    assert first.dataset("flow", "valve").missing == 200


def test_channels_are_chosen_by_name_in_the_order_given() -> None:
    chosen = driven().channels(["level", "temperature"], "valve")

    assert (chosen.outputs, chosen.inputs) == (("level", "temperature"), ("valve",))
    assert (chosen.units, chosen.input_units) == (("m", "K"), ("%",))
    np.testing.assert_array_equal(chosen.y, driven().y[:, [2, 0]])


def test_merged_experiments_keep_their_boundaries() -> None:
    first, second = driven(1), driven(2)

    merged = armrig.merge([first, second[100:]])

    assert merged.starts == (0, 200, 600, 700)
    np.testing.assert_array_equal(merged.y[600:], second.y[100:])
    assert merged.history[0] == "made"
    assert merged.source == first.source
    other = second.replaced(step=None, source="cd")
    assert armrig.merge([first, other, first]).source == f"{first.source}+cd"
    assert merged.digest != first.digest
    with pytest.raises(InputError, match=r"the same outputs in all data, got \[.*, .*\]"):
        armrig.merge([first, first.channels(["level"])])
    with pytest.raises(InputTypeError, match="one list of Signals"):
        armrig.merge([first, first.dataset("level", "valve")])  # type: ignore[list-item]


TREATMENTS: dict[str, Any] = {
    "detrend": armrig.detrend,
    "line": lambda data: armrig.detrend(data, 1),
    "resample": lambda data: armrig.resample(data, 0.2),
    "prefilter": lambda data: armrig.prefilter(data, band=(0, 20.0), order=1),
    "difference": armrig.difference,
}


@pytest.mark.filterwarnings("ignore::armrig.data.treatment.IntegratingOutputWarning")
@pytest.mark.parametrize("name", TREATMENTS)
def test_a_treatment_of_signals_is_that_of_each_pair(name: str) -> None:
    treatment, signals = TREATMENTS[name], driven(missing=0.02)

    found = treatment(signals)

    for output in signals.outputs:
        for input in signals.inputs:
            pair = treatment(signals.dataset(output, input))
            i, j = signals.output(output), signals.input(input)
            np.testing.assert_array_equal(found.u[:, j], pair.u)
            np.testing.assert_array_equal(found.y[:, i], pair.y)
            assert (found.Ts, found.starts, found.units[i]) == (pair.Ts, pair.starts, pair.unit)
            assert found.outputs[i] == pair.output
    assert found.history[0] == "made"
    assert codes_of(found.history)[-1] == codes_of(pair.history)[-1]


def test_outliers_of_each_output_are_found_with_all_inputs() -> None:
    signals = driven()
    y = signals.y.copy()
    y[300, 0] += 3.0
    y[450, 2] -= 2.0
    spoilt = signals.replaced(step=None, y=y)

    found = armrig.hampel(spoilt)

    assert np.argwhere(~found.valid).tolist() == [[300, 0], [450, 2]]
    assert len(found.history) == 4
    # The second input moves the temperature: a model without it has larger residuals.
    alone = armrig.hampel(spoilt.channels("temperature", "valve"))
    assert not alone.valid[300, 0] or alone.valid.all()


U, Y = np.ones((20, 2)), np.ones((20, 2))
WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "lengths": ({"y": Y[:9]}, "u has 20 samples and y has 9; both need one value for each instant"),
    "rows": ({"y": Y.T}, r"y has 2 rows and 20 columns, .*; give y\.T if"),
    "cube": ({"y": np.ones((20, 2, 2))}, r"y has shape \(20, 2, 2\); give \(N, n\)"),
    "text": ({"u": np.array(["a"] * 20)}, "u is an array of <U1; give real numbers"),
    "complex": ({"u": U * 1j}, "u is an array of complex128; give real numbers"),
    "names": ({"inputs": ["a"]}, r"inputs=\['a'\]: 2 names are needed, one for each column of u"),
    "repeated": ({"outputs": ["a", "a"]}, "outputs: a repeats; each channel needs its own name"),
    "both": ({"inputs": ["a", "y1"]}, "y1: the name of both an input and an output"),
    "hold": ({"intersample": "linear"}, 'intersample=\'linear\' must be "zoh" or "foh"'),
    "no sample": ({"valid": [[True, False]] * 20}, "y2 has no valid sample in 20; leave"),
    "no rate": ({"Ts": None}, "give either Ts, the sampling time in s, or t, the time of each"),
    "rates": ({"t": np.arange(20.0)}, "give either Ts, the sampling time in s, or t"),
    "Ts": ({"Ts": 0}, "Ts=0 must be from 1e-12"),
    "t": ({"Ts": None, "t": np.zeros(20)}, "t must rise from each sample of an experiment"),
    "times": ({"Ts": None, "t": np.arange(3.0)}, r"t has shape \(3,\); give 20 finite times"),
    "starts": ({"starts": (1,)}, r"starts=\(1,\) must begin with 0"),
    "huge": ({"y": 1e40 * Y}, "the largest .*; use a unit"),
}


@pytest.mark.parametrize("what", WRONG)
def test_wrong_signals_are_refused_in_one_line(what: str) -> None:
    fields, said = WRONG[what]
    with pytest.raises(InputError, match=said) as found:
        Signals(**{"u": U, "y": Y, "Ts": 0.1} | fields)
    assert len(str(found.value).splitlines()) == 1


def test_a_pair_must_be_chosen() -> None:
    signals = driven()
    said = r"3 outputs \(temperature, flow, level\) and 2 inputs \(heater, valve\): choose one of"
    for ask in (
        signals.dataset,
        lambda: armrig.spa(signals),
        lambda: armrig.iv4(signals, na=1, nb=1),
    ):
        with pytest.raises(InputError, match=said):
            ask()
    with pytest.raises(InputError, match="output='fan': there is no such output; there are"):
        signals.dataset("fan", "valve")


def test_the_repr_of_signals_lists_channels_units_and_history() -> None:
    assert repr(driven(missing=0.1)[:300]) == (
        "<Signals: 300 samples at 0.1 s; outputs temperature [K], flow [l/s], level [m]; inputs "
        "heater [V], valve [%]; 105 values missing (11.7 %); 2 experiments; history: made; took "
        "samples 0 to 299 of 600>"
    )
    assert "<img" in driven()._repr_html_()


def test_an_input_is_drawn_as_it_runs_between_samples_and_experiments_are_marked() -> None:
    signals = driven().replaced(step=None, intersample=["foh", "zoh"])

    panels = signals.plot(ax=Figure().add_subplot()).axes

    straight, held = (panel.lines[0] for panel in panels[3:])
    assert [line.get_drawstyle() for line in (straight, held)] == ["default", "steps-post"]
    for j, line in enumerate((straight, held)):
        np.testing.assert_array_equal(line.get_ydata(), signals.u[:, j])
    for panel in panels:
        assert [line.get_xdata() for line in panel.lines[1:]] == [[20.0, 20.0]]
        assert panel.get_xlim() == pytest.approx((0.0, 59.9))


@SHAPES
@pytest.mark.parametrize("kind", ["time", "spectrum", "values"])
def test_each_channel_is_drawn_in_a_panel_with_its_unit(kind: Any, shape: tuple[int, int]) -> None:
    signals = driven(missing=0.1, shape=shape)

    panels = signals.plot(kind, ax=Figure().add_subplot()).axes

    names, units = (*signals.outputs, *signals.inputs), (*signals.units, *signals.input_units)
    for panel, name, unit in zip(panels, names, units, strict=True):
        text = panel.get_ylabel() + panel.get_xlabel()
        assert name in text
        assert unit in text


def test_a_part_knows_its_time_and_its_merge_its_channels() -> None:
    even = driven()

    assert span_of(even[150:320].history) == pytest.approx((15.0, 32.0))
    merged = armrig.merge([even[:150], even[150:]])
    np.testing.assert_array_equal(merged.t, even.t)
    assert merged.starts == (0, 150, 200)
    parts = [even.channels(intersample_of, None) for intersample_of in (["flow"], ["level"])]
    with pytest.raises(InputError, match=r"the same outputs .*'flow'.*'level'"):
        armrig.merge(parts)
    for change, name in (
        ({"intersample": "foh"}, "intersample"),
        ({"units": ["K", "l/s", "cm"]}, "units"),
        ({"Ts": 0.2}, "Ts"),
    ):
        with pytest.raises(InputError, match=f"merge needs the same {name} in all data"):
            armrig.merge([even, even.replaced(step=None, **change)])


# Files.


def columns() -> NDArray[np.float64]:
    """Return t, two inputs and two outputs of 30 instants."""
    k = np.arange(30.0)
    return np.column_stack([0.5 * k, k % 3, k % 4, k % 5, k % 7])


def written(
    folder: Path, table: NDArray[np.float64], header: str = "t [s],u1 [V],u2,y1,y2 [m]"
) -> Path:
    """Write a CSV, empty where a number is NaN."""
    path = folder / "plant.csv"
    rows = [",".join("" if np.isnan(x) else f"{x:g}" for x in row) for row in table]
    path.write_text("\n".join([header, *rows]))
    return path


def test_a_csv_with_names_is_read(tmp_path: Path) -> None:
    """A missing input ends an experiment; a missing output is missing alone."""
    table = columns()
    table[10:12, 1] = table[20, 3] = np.nan

    found = armrig.load_signals(written(tmp_path, table), inputs=["u1", "u2"], outputs=["y2", "y1"])

    assert (found.inputs, found.outputs) == (("u1", "u2"), ("y2", "y1"))
    assert (found.input_units, found.units, found.Ts) == (("V", ""), ("m", ""), 0.5)
    np.testing.assert_array_equal(found.y, np.delete(table, [10, 11], axis=0)[:, [4, 3]])
    assert (found.N, found.starts) == (28, (0, 10))
    assert np.argwhere(~found.valid).tolist() == [[18, 1]]
    assert found.source.startswith("data:")


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"inputs": ["u1", "2"], "outputs": ["t"]}, "input and input are both column 2; give --i"),
        (
            {"inputs": ["t"], "outputs": ["u1", "u1"]},
            "signal and signal are both column 2; give --s",
        ),
        ({"inputs": [], "outputs": ["y1"]}, "give at least one input; give --input"),
        ({"inputs": ["u1"], "outputs": []}, "give at least one signal; give --signal"),
    ],
)
def test_wrong_columns_are_refused_with_the_remedy(
    tmp_path: Path, asked: dict[str, Any], said: str
) -> None:
    path = written(tmp_path, columns())
    with pytest.raises(FileError, match=said) as found:
        armrig.load_signals(path, **asked)
    assert str(found.value).startswith(f"{path}: ")
