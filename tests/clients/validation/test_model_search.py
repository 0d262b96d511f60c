"""The search for a model: ranked on other data, simpler where that is as good."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import TYPE_CHECKING, Any

import armrig
import numpy as np
import pytest
from armrig import Signals
from armrig.data.dataset import Dataset
from armrig.data.treatment.integrating import Integration
from armrig.estimation.arx import arx
from armrig.excitation import telegraph
from armrig.models.fit import Fit
from armrig.models.structure_table import OfferedName
from armrig.numerics.polynomial import apply_filter
from armrig.validation.model_search import _is_as_good, search
from armrig.validation.search_result import Candidate, SearchResult
from armrig_core.errors import InputError

from tests.clients.estimation.test_transfer_functions import data as delayed
from tests.clients.validation.plants import (
    SAMPLES,
    of_second_order,
    switched,
    two_outputs,
    under_control,
)
from tests.sampling import sampled

if TYPE_CHECKING:
    from tests.clients.handout_plant import HandoutPlant


def tried(found: SearchResult) -> list[Candidate]:
    """Return the candidates with and without a usable model."""
    return [*(scored.candidate for scored in found.ranked), *found.failed]


def _data(seed: int, C: list[float], D: list[float], N: int = 1500) -> Dataset:
    rng = np.random.default_rng(seed)
    u = telegraph(N, 0.3, 1.5, 3.5, seed=rng) - 2.5
    y = apply_filter([0.0, 1.0, 0.5], [1.0, -1.2, 0.6], u)
    return Dataset(u=u, y=y + apply_filter(C, D, 0.5 * rng.standard_normal(N)), Ts=1.0)


@pytest.mark.parametrize(
    ("C", "D", "chosen"),
    sampled(
        [
            ([1.0], [1.0, -1.2, 0.6], {"ARX[2 2 1]", "IV4[2 2 1]"}),
            ([1.0], [1.0], {"OE[2 2 1]"}),
            ([1.0, 0.9], [1.0, -0.7], {"BJ[2 1 1 2 1]"}),
        ]
    ),
    ids=["ARX", "OE", "BJ"],
)
def test_the_true_structure_is_chosen_by_prediction(
    C: list[float], D: list[float], chosen: set[str]
) -> None:
    found = search(
        _data(9, C, D),
        _data(10, C, D),
        families=("arx", "iv4", "oe", "bj"),
        orders=range(1, 4),
        horizon=1,
    )

    assert found.chosen.candidate.name in chosen
    assert found.excess[found.chosen_index] <= found.excess_std[found.chosen_index]
    assert (np.diff(found.rms) >= 0).all()


def test_the_search_finds_the_integrator_of_the_arm_and_states_reasons(plant: HandoutPlant) -> None:
    found = search(
        plant.dataset(1), plant.dataset(2), families=("arx", "oe", "n4sid"), orders=range(2, 6)
    )

    assert found.chosen.candidate.name == "OE[4 4 1]"
    assert found.fit.integrator
    assert "fewer parameters are not enough: OE[3 3 1]" in found.explain()


@pytest.mark.parametrize(("highest", "said"), [(2, True), (3, False)])
def test_the_highest_order_that_was_tried_is_reported_if_chosen(highest: int, said: bool) -> None:
    found = search(
        _data(1, [1.0], [1.0]),
        _data(2, [1.0], [1.0]),
        families=("oe",),
        orders=range(1, highest + 1),
    )

    assert found.chosen.candidate.order == 2
    expected = "order 2 is the highest that was tried, so a higher order may be better"
    assert (expected in found.explain()) == said
    assert ("--max-order 4 (in Python, orders=range(1, 5))" in found.explain()) == said


@pytest.mark.parametrize(("direct", "delays"), [(0.4, {0, 1}), (0.0, {1})])
def test_a_direct_term_is_tried_if_the_data_show_one(direct: float, delays: set[int]) -> None:
    rng = np.random.default_rng(1)
    u = telegraph(1000, 0.3, 1.5, 3.5, seed=rng) - 2.5
    y = apply_filter([direct, 1.0], [1.0, -0.8], u) + 0.3 * rng.standard_normal(1000)

    found = search(Dataset(u=u, y=y, Ts=1.0), families=("oe",), orders=(1, 2))

    assert {j.candidate.request.nk for j in found.ranked} == delays
    assert found.fit.nk == min(delays)


def test_a_subspace_model_is_estimated_for_the_horizon_of_the_ranking() -> None:
    """The best simulation model is the output-error model, but one step ahead it is not."""
    data, other = (_data(seed, [1.0], [1.0, -0.9], 600) for seed in (1, 2))

    simulated = search(data, other, families=("n4sid", "oe"), orders=(2,))
    ahead = search(data, other, families=("n4sid", "oe"), orders=(2,), horizon=1)

    A, F = (_of(simulated, family).denominator for family in ("n4sid", "oe"))
    np.testing.assert_allclose(A, F, rtol=1e-3)
    assert np.abs(_of(ahead, "n4sid").denominator - F).max() > 1e-3


def _of(found: SearchResult, family: str) -> Fit:
    return next(j.fit for j in found.ranked if j.candidate.request.structure == family)


@pytest.fixture(scope="module")
def elsewhere() -> Iterator[ProcessPoolExecutor]:
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as executor:
        yield executor


@pytest.mark.exhaustive
def test_a_search_with_several_processes_finds_the_same_model(
    elsewhere: ProcessPoolExecutor,
) -> None:
    data = _data(1, [1.0], [1.0], 400)

    here = search(data, families=("oe",), orders=(1, 2))
    there = search(data, families=("oe",), orders=(1, 2), executor=elsewhere)

    np.testing.assert_array_equal(here.fit.theta, there.fit.theta)
    np.testing.assert_array_equal(here.rms, there.rms)


def test_a_failed_candidate_is_reported_and_does_not_stop_the_search() -> None:
    data = _data(1, [1.0], [1.0], 80)

    found = search(data, families=("arx",), orders=(1, 2, 30))

    assert [one.name for one in found.failed] == ["ARX[30 30 1]"]
    assert "without a usable model: 1, such as ARX[30 30 1]: na=30, nb=30" in found.explain()
    assert found.chosen.candidate.order == max(j.candidate.order for j in found.ranked)
    assert "the highest that was tried" not in found.explain()


@pytest.mark.parametrize("family", sampled(["arx", "iv4", "armax", "oe", "bj", "n4sid"], 4))
def test_a_pole_outside_the_circle_is_never_chosen(family: OfferedName) -> None:
    estimation, validation = _of_one_pole(1.004, 200, 1), _of_one_pole(1.004, 60, 2)

    found = search(estimation, validation, families=(family,), orders=(1, 2), integrator=False)

    assert found.ranked
    assert all((abs(j.fit.poles().values) < 1).all() for j in found.ranked)
    moved = any("reflected into the circle" in w for w in found.fit.warnings)
    assert moved or family in ("oe", "bj", "n4sid")  # those look inside the circle only


def test_a_pole_that_rounding_leaves_outside_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four poles at 1 hardly move by the reflection."""
    data = _of_one_pole(1.004, 200, 1)

    def unstable(data: Dataset, *, stable: bool, **orders: int) -> Fit:
        return arx(data, **orders)

    monkeypatch.setattr("armrig.arx", unstable)

    with pytest.raises(ValueError, match=r"ARX\[1 1 1\]: a pole is unstable, \|z\| = 1.0040"):
        search(data, families=("arx",), orders=(1,))


def test_a_model_with_an_unbounded_output_is_not_ranked() -> None:
    estimation, validation = (
        _of_one_pole(pole, N, seed) for pole, N, seed in ((1.3, 100, 1), (0.9, 700, 2))
    )

    with pytest.raises(ValueError, match=r"first, ARX\[1 1 1\]: its output is unbounded"):
        search(estimation, validation, families=("arx",), orders=range(1, 2))


def _of_one_pole(pole: float, N: int, seed: int) -> Dataset:
    rng = np.random.default_rng(seed)
    u = rng.choice([0.0, 1.0], N)
    y = apply_filter(np.array([0.0, 1.0]), np.array([1.0, -pole]), u)
    return Dataset(u=u, y=y + 1e-3 * rng.standard_normal(N), Ts=1.0)


@pytest.mark.parametrize(("poles", "highest"), [(2, 5), (6, 7)])
def test_orders_above_five_are_tried_while_the_choice_has_the_highest(
    poles: int, highest: int
) -> None:
    rng = np.random.default_rng(1)
    u = rng.choice([-1.0, 1.0], 400)
    F = np.real(
        np.poly([0.95 * np.exp(s * w * 1j) for w in (0.4, 1.2, 2.2) for s in (1, -1)][:poles])
    )
    y = apply_filter([0.0, 1.0], F, u)
    data = Dataset(u=u, y=y + 0.01 * rng.standard_normal(400), Ts=1.0)

    found = search(data, families=("oe",), nk=1, integrator=False, offset=False)

    assert found.chosen.candidate.order == poles
    assert sorted(scored.candidate.order for scored in found.ranked) == [*range(1, highest + 1)]


def test_an_optional_structure_is_searched_on_request() -> None:
    data = of_second_order(switched())

    usual = search(data, orders=(2,), nk=1)
    asked = search(data, families=("ararx",), orders=(2,), nk=1, offset=False)

    assert "ararx" not in {one.request.structure for one in tried(usual)}
    assert {j.candidate.name for j in asked.ranked} == {"ARARX[2 2 1 1]", "ARARX[2 2 2 1]"}


@pytest.mark.parametrize(
    ("shape", "unknown", "allowed", "order"),
    [("1x1", "arimax", "arx, armax", 40), ("2x2", "arx", "oe, n4sid, ss", 9)],
)
def test_unknown_families_and_impossible_orders_are_refused(
    shape: str, unknown: Any, allowed: str, order: int
) -> None:
    data: Any = _data(1, [1.0], [1.0], 80) if shape == "1x1" else two_outputs(0)[:20]

    with pytest.raises(
        InputError, match=f"families has '{unknown}'; each must be one of {allowed}"
    ):
        search(data, families=(unknown,))
    with pytest.raises(InputError, match="none of the structures could be estimated; the first"):
        search(data, families=("oe",), orders=(order,))


@pytest.mark.exhaustive
@pytest.mark.parametrize("processes", [0, 2])
def test_progress_is_reported_before_each_candidate_and_at_the_end(
    processes: int, elsewhere: ProcessPoolExecutor
) -> None:
    told: list[tuple[int, int, str]] = []

    search(
        _data(1, [1.0], [1.0], N=400),
        families=("arx", "oe"),
        orders=(1, 2),
        nk=1,
        executor=elsewhere if processes else None,
        progress=lambda *count: told.append(count),
    )

    names = ["ARX[1 1 1]", "ARX[2 2 1]", "OE[1 1 1]", "OE[2 2 1]", "OE[2 2 1], level", ""]
    assert told == [(k, 5, name) for k, name in enumerate(names)]


@pytest.mark.exhaustive
def test_a_search_in_closed_loop_does_not_identify_the_controller() -> None:
    found = search(under_control(), orders=(1, 2))

    assert {j.candidate.request.structure for j in found.ranked} == {"arx", "armax", "bj"}
    assert {j.candidate.request.nk for j in found.ranked} == {1}
    assert found.horizon == 1
    assert [f.about for f in found.doubts] == ["feedback"]
    assert "doubt about the data, feedback: the data look as if u depends on y" in found.explain()


def test_a_delay_is_searched_with_the_nk_that_the_data_show() -> None:
    """The nk is four; another delay would need three more coefficients."""
    data = of_second_order(switched(), nk=4)
    found = search(data, families=("oe",), orders=(1, 2, 3))

    assert {j.fit.nk for j in found.ranked} == {4}
    assert found.chosen.candidate.order <= 3
    assert found.halved
    assert found.fit.estimated_from(data)
    assert found.chosen.error.size == data.N  # each half was predicted by the other half's model
    again = armrig.oe(data, **found.chosen.candidate.request.counts)
    assert [s.name for s in found.fit.search.starts] == [s.name for s in again.search.starts]
    assert "the part of the data that did not estimate them" in found.table()


def test_poles_and_delay_suggest_a_process() -> None:
    """A plant of first order with dead time has three parameters, also if samples are missing."""
    data = delayed(delay=1.23, B=(2.0,), F=(1, 0.8))
    y = np.where(np.arange(data.N) == 60, np.nan, data.y)
    data = Dataset(u=data.u, y=y, Ts=data.Ts)
    found = search(data, orders=(1, 2))

    assert found.chosen.candidate.name == found.fit.label == "PROCESS(P1D)"
    assert found.chosen.parameters == 3
    np.testing.assert_array_equal(found.fit.theta, armrig.process(data, "P1D").theta)


def test_a_level_of_only_the_validation_data_is_estimated() -> None:
    first, second = of_second_order(switched()).split(2)
    second = Dataset(u=second.u, y=second.y + 5.0, Ts=second.Ts)

    found = search(first, second, families=("arx", "oe"), orders=(1, 2, 3))

    assert found.fit.offset
    assert found.chosen.candidate.order == 2
    assert any(note.startswith("in the validation data y is about") for note in found.notes)


def test_a_model_of_all_data_that_is_worse_than_those_of_halves_is_not_chosen(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    answers = iter([False, True])
    monkeypatch.setattr(
        "armrig.validation.model_search._is_as_good", lambda *_: next(answers, True)
    )
    data = of_second_order(switched())

    found = search(data, families=("arx",), orders=(2, 3), nk=1, offset=False)

    assert [one.name for one in found.failed] == ["ARX[3 3 1]"]
    assert found.chosen.candidate.name == "ARX[2 2 1]"
    assert found.fit.estimated_from(data)
    assert "such as ARX[3 3 1]: the model of all the data has larger errors" in found.explain()


@pytest.mark.parametrize(("error", "expected"), [(1.0, True), (0.01, False)])
def test_a_model_of_all_data_is_compared_with_the_errors_of_halves(
    error: float, expected: bool
) -> None:
    data = _data(5, [1.0], [1.0], N=300)  # noise of 0.5
    fit = armrig.oe(data, nb=2, nf=2, nk=1)

    assert _is_as_good(fit, np.full(300, error), data, None) is expected


@pytest.mark.parametrize(("agreed", "starts"), [(True, "few"), (False, None)])
def test_the_best_models_are_estimated_again_with_all_starts_if_the_few_disagreed(
    agreed: bool, starts: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("armrig.estimation.prediction_error.same_minimum", lambda *_: agreed)

    first, second = _data(5, [1.0], [1.0], N=600).split(2)
    found = search(first, second, families=("oe",), orders=(2, 3), nk=1, offset=False)

    assert sorted(one.name for one in tried(found)) == ["OE[2 2 1]", "OE[3 3 1]"]
    assert {one.request.starts for one in tried(found)} == {starts}


def test_a_level_that_slow_noise_hides_from_its_test_is_tried_with_the_choice() -> None:
    data = _data(5, [1.0], [1.0, -0.97], N=400)
    high = Dataset(u=data.u, y=data.y + 4.0, Ts=1.0)

    found, without = (
        search(high, families=("oe",), orders=(2,), offset=offset) for offset in (None, False)
    )

    assert not found.notes
    assert found.chosen.candidate.name == "OE[2 2 1], level"
    assert found.fit.offset
    assert [one.name for one in tried(without)] == ["OE[2 2 1]"]


def test_an_output_that_is_found_to_integrate_gets_its_integrator() -> None:
    data = of_second_order(switched())
    found = search(
        Dataset(u=data.u, y=0.05 * np.cumsum(data.y), Ts=0.02), families=("oe",), orders=(3,)
    )

    assert found.fit.integrator
    assert "taken as integrating" in found.explain()


@pytest.mark.parametrize(
    ("families", "expected"),
    [
        (("arx", "oe"), {"ARX[3 3 1]", "OE[3 3 1]", "OE[3 3 1], pole at 1"}),
        (("n4sid", "oe"), {"N4SID[3 1]", "N4SID[3 1], pole at 1", "OE[3 3 1], pole at 1"}),
    ],
    ids=["all of them", "first the subspace models"],
)
def test_other_data_decide_on_an_integrator_that_the_test_leaves_open(
    families: tuple[OfferedName, ...], expected: set[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    data = of_second_order(switched())
    data = Dataset(u=data.u, y=0.05 * np.cumsum(data.y), Ts=0.02)
    undecided = Integration(integrates=False, undecided=True)
    for module in ("model_search", "advice"):
        monkeypatch.setattr(f"armrig.validation.{module}.integration", lambda *_: undecided)
    told: list[tuple[int, int, str]] = []

    found = search(
        data, families=families, orders=(3,), nk=1, progress=lambda *count: told.append(count)
    )

    assert {one.name for one in tried(found)} == expected
    assert found.chosen.candidate.name.endswith(", pole at 1")
    level = 1  # which a choice with an integrator does not need
    assert told[-1] == (len(families) * 2 - ("arx" in families) + level,) * 2 + ("",)
    assert {total for _, total, _ in told} == {told[-1][0]}


def test_the_search_chooses_the_order_of_the_plant() -> None:
    data = two_outputs(2, cross=0.0)  # poles: a pair, 0.3, 0.7
    done: list[str] = []

    found: Any = armrig.search(
        data,
        two_outputs(102, cross=0.0),  # type: ignore[arg-type]
        families=["ss"],  # type: ignore[list-item]
        orders=(3, 4, 5),
        progress=lambda k, n, name: done.append(f"{k} of {n} {name}"),
    )

    assert found.chosen.candidate.name == "SS[4 1]"
    assert found.fit.estimated_from(data)
    # The last of the 4 would be a model with a level, which ss does not estimate.
    assert done == ["0 of 4 SS[3 1]", "1 of 4 SS[4 1]", "2 of 4 SS[5 1]", "4 of 4 "]
    assert "  <- chosen" in repr(found)
    assert found.tests.outputs == ("y1", "y2")
    assert not found.tests.rejects


@pytest.mark.parametrize("missing", [0.0, 0.1])
def test_a_state_space_has_no_k_if_samples_are_missing(missing: float) -> None:
    found: Any = armrig.search(two_outputs(2, missing=missing), families=["ss"], orders=[2])

    assert found.fit.form.K.any() == (not missing)


@pytest.mark.exhaustive
def test_the_search_finds_the_integrator_of_one_output() -> None:
    rng = np.random.default_rng(3)
    u = np.repeat(np.sign(rng.standard_normal(SAMPLES // 4)), 4)
    rate = apply_filter([0, 0.4, 0.2], np.poly([0.8, 0.5]), u)
    y = np.column_stack([np.cumsum(rate), rate]) + 0.05 * rng.standard_normal((SAMPLES, 2))
    data = Signals(u=u[:, None], y=y, Ts=0.1, outputs=["angle", "rate"])

    found: Any = armrig.search(data, integrator="angle", orders=(1, 2, 3))  # type: ignore[arg-type]

    assert found.chosen.candidate.name == "OE[2 2 1]"
    assert found.fit.form.integrators == (True, False)


def test_every_family_of_a_search_has_all_orders_of_an_iterator() -> None:
    found: Any = armrig.search(two_outputs(0), families=["n4sid", "oe"], orders=iter((1, 2)))

    orders = {(one.request.structure, one.order) for one in tried(found)}
    assert orders == {("n4sid", 1), ("n4sid", 2), ("oe", 1), ("oe", 2)}


def test_if_an_input_rests_in_one_part_the_models_are_ranked_on_their_own_data() -> None:
    data = two_outputs(0)
    u = np.column_stack([data.u[:, 0], np.where(np.arange(data.N) < 9, 0.0, 1.0), data.u[:, 1:]])
    rests = Signals(u=u, y=data.y, Ts=1.0)

    found: Any = armrig.search(rests, families=["oe"], orders=[1, 2])

    assert not found.halved
    assert found.fit.estimated_from(rests)
    assert found.notes[0].startswith("u moves in one part of the data only, so Akaike's FPE")
    i = found.ranked.index(found.chosen)
    loss = float(np.mean(np.sum((found.chosen.error / np.std(rests.y, axis=0)) ** 2, axis=1)))
    assert found.rms[i] == pytest.approx(np.sqrt(loss))


def test_a_level_of_one_of_several_outputs_is_estimated() -> None:
    data = two_outputs(0)
    high = data.replaced(step=None, y=data.y + np.array([0.0, 5.0]))
    found: Any = search(high, families=["oe"], orders=[1])

    assert found.fit.offset
    assert found.notes[0].startswith("y2 is about 5")


def test_theta_1_integrates_if_a_structure_can_have_a_fixed_pole() -> None:
    data = two_outputs(0, cross=0.0).replaced(step=None, outputs=("theta_1", "alpha"))
    cases: list[Any] = [None, ("ss",), ("ss", "oe")]

    found = (tried(search(data, families=families, orders=(1,))) for families in cases)

    assert [{one.request.structure for one in of} for of in found] == [{"oe"}, {"ss"}, {"oe"}]


def test_a_last_choice_with_larger_errors_than_its_halves_has_a_note(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("armrig.validation.model_search._is_as_good", lambda *_: False)

    found = search(_of_one_pole(0.8, 200, 1), families=["arx"], orders=[1], offset=False)

    assert found.notes[-1] == "the model of all the data has larger errors than those of halves"
