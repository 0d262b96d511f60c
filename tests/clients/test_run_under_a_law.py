"""A run under a control law is a closed loop for all clients, whatever a test finds."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import armrig
import numpy as np
import pytest
import scipy.io
from armrig.cli import main
from armrig.models.structure_table import OFFERED
from armrig.recordings.files import loading
from armrig.recordings.files.control_run import control_run
from armrig.rig.playback import read_run
from armrig_core.commands.commands import ControlRequest
from armrig_core.errors import InputError
from armrig_daemon.config import Config
from armrig_daemon.service.virtual_service import LEASE, VirtualService

from tests.core.control.laws import arm_law

LAW = arm_law()
NAMED = f"controlled by the law {LAW.sha256[:12]}"
N = 1000
R = np.repeat(np.random.default_rng(1).choice([2.0, 4.0], N // 20), 20)
ORDERS = {"nb": 3, "nf": 3}


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a recording of the arm's speed under a law of order 5."""
    service = VirtualService(Config(), tmp_path_factory.mktemp("run"), seed=1)
    request = ControlRequest(lease=LEASE, n=0, law=LAW, reference=R.tolist(), unmonitored=True)
    return service.record(request)


@pytest.fixture(scope="module")
def data(path: Path) -> armrig.Dataset:
    """Give u and alpha of the recording."""
    return armrig.load(path).dataset("alpha")


def weak(data: armrig.Dataset) -> armrig.Dataset:
    """Return the data with an input on which the noise of y has no effect: a test finds nothing."""
    u = armrig.telegraph(data.N, 0.1, 0.5, 4.5, seed=3)
    y = armrig.oe(data, **ORDERS).simulate(u) + 0.01 * np.random.default_rng(1).standard_normal(N)
    return data.replaced(step=None, u=u, y=y, valid=np.ones(N, dtype=np.bool_))


def test_the_reference_of_each_sample_is_that_of_the_law(path: Path) -> None:
    recording, part = armrig.load(path), armrig.load(path, start=2.0, stop=3.0)

    np.testing.assert_array_equal(recording.r, R)
    np.testing.assert_array_equal(part.r, R[200:300])
    np.testing.assert_array_equal(part.dataset("velocity").r, R[200:300])
    np.testing.assert_array_equal(recording.signals().r, R)
    assert recording.dataset().history == (NAMED,)
    assert armrig.example_recording().r is None


def test_the_last_reference_holds_after_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    decisions = {"k": np.array([7.0, 8.0]), "r": np.array([1.0, 2.0]), "reference_n": np.zeros(2)}
    monkeypatch.setattr(loading, "law_decisions", lambda _: decisions)
    monkeypatch.setattr(loading, "read_input", lambda *_: np.array([1.0, 2.0, 3.0]))
    content: Any = SimpleNamespace(input=object(), input_sha256="a")
    manifest: Any = SimpleNamespace(controller_sha256="b", k_first=7, samples=5)
    rows: Any = SimpleNamespace(k_first=8, N=4)

    np.testing.assert_array_equal(
        loading._reference([Path("a.mcap")], content, manifest, rows), [2.0, 3.0, 3.0, 3.0]
    )


def test_a_reference_of_a_command_holds_to_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    decisions = {
        "k": np.array([7.0, 8.0, 10.0]),
        "r": np.array([1.0, 2.0, 5.0]),
        "reference_n": np.array([0.0, 0.0, 4.0]),
    }
    monkeypatch.setattr(loading, "law_decisions", lambda _: decisions)
    monkeypatch.setattr(loading, "read_input", lambda *_: np.array([1.0, 2.0, 3.0, 3.0, 3.0]))
    content: Any = SimpleNamespace(input=object(), input_sha256="a")
    manifest: Any = SimpleNamespace(controller_sha256="b", k_first=7, samples=5)
    rows: Any = SimpleNamespace(k_first=7, N=5)

    np.testing.assert_array_equal(
        loading._reference([Path("a.mcap")], content, manifest, rows), [1.0, 2.0, 3.0, 5.0, 5.0]
    )


def test_feedback_is_known_where_the_test_finds_none(data: armrig.Dataset) -> None:
    found = armrig.open_loop(weak(data))

    assert found.p_value > 0.05
    assert found.feedback is True
    assert found.laws == (LAW.sha256,)
    assert repr(found).startswith(f"FEEDBACK, known without the test: {NAMED} (Sims' F-test")
    assert not armrig.open_loop(weak(data).replaced(step=None, history=[])).feedback


def test_feedback_is_known_without_enough_samples_for_the_test(data: armrig.Dataset) -> None:
    found = armrig.open_loop(data[:60])

    assert (found.feedback, found.sims) == (True, None)
    assert "needs at least" in found.explain()
    assert "Estimate BJ or ARMAX" in found.explain()


def test_an_effect_at_lag_0_is_no_direct_term(data: armrig.Dataset) -> None:
    """The same data without the law are taken for a rig with nk = 0."""
    direct = weak(data)
    direct = direct.replaced(step=None, y=direct.y + 0.02 * direct.u, output="y")

    assert armrig.delay(direct.replaced(step=None, history=[])).nk == 0
    assert armrig.delay(direct).interval == (1, 1)
    found = armrig.search(direct, families=["arx"], orders=[3], open_loop=True)
    assert all(one.candidate.request.nk >= 1 for one in found.ranked)


def test_hints_begin_with_bj(data: armrig.Dataset) -> None:
    found = armrig.structure_hints(weak(data))

    assert found.family == "bj"
    assert [f.about for f in found.doubts] == ["feedback"]
    assert found.doubts[0].text.startswith(NAMED)


def test_a_search_tries_unbiased_structures_only(data: armrig.Dataset) -> None:
    found = armrig.search(weak(data), orders=[3])

    tried = {s.candidate.request.structure for s in found.ranked}
    tried |= {candidate.request.structure for candidate in found.failed}
    assert tried == {"arx", "armax", "bj"}
    assert all(OFFERED[name].closed_loop for name in tried)
    assert found.horizon == 1
    assert "feedback" not in {f.about for f in found.doubts}


def test_the_test_of_linearity_is_valid_under_a_law(data: armrig.Dataset) -> None:
    found = armrig.linearity(data)

    assert not found.closed
    assert found.linear
    assert "linearity" in {f.about for f in armrig.advice(data).findings}


def test_feedback_in_the_residuals_rejects_no_model(data: armrig.Dataset) -> None:
    found = armrig.residuals(armrig.oe(data, **ORDERS), data)
    object.__setattr__(found, "feedback", 1e-9)

    assert found.laws == (LAW.sha256,)
    assert f"feedback, by the law {LAW.sha256[:12]} (p < 0.001)" in repr(found)
    object.__setattr__(found, "laws", ())
    assert found.rejects


@pytest.mark.parametrize(
    "estimate",
    [
        lambda d: armrig.oe(d, **ORDERS),
        lambda d: armrig.iv4(d, na=3, nb=3),
        lambda d: armrig.n4sid(d, order=3),
        lambda d: armrig.tf(d, poles=3),
        lambda d: armrig.process(d, "P2U"),
        armrig.spa,
        armrig.etfe,
        armrig.impulse_response,
        armrig.correlation,
    ],
)
def test_the_first_line_of_a_biased_estimate_is_a_warning(
    estimate: Any, data: armrig.Dataset
) -> None:
    first = repr(estimate(data)).splitlines()[0]

    assert first.partition(": ")[2].startswith(f"{NAMED}: coloured noise in the loop biases")
    assert "or armrig.two_stage" in first


@pytest.mark.parametrize(
    "estimate",
    [
        lambda d: armrig.bj(d, **ORDERS, nc=1, nd=1),
        lambda d: armrig.armax(d, na=3, nb=3, nc=3),
        lambda d: armrig.two_stage(d, **ORDERS),
    ],
)
def test_an_unbiased_estimate_has_no_warning_of_the_loop(
    estimate: Any, data: armrig.Dataset
) -> None:
    assert "loop" not in repr(estimate(data))


def test_two_stages_need_a_reference(data: armrig.Dataset) -> None:
    given = armrig.two_stage(data.replaced(step=None, r=None), R, **ORDERS)

    np.testing.assert_array_equal(armrig.two_stage(data, **ORDERS).theta, given.theta)
    with pytest.raises(InputError, match="two_stage needs r, the set point"):
        armrig.two_stage(armrig.resample(data, 0.02), **ORDERS)


def test_identify_has_two_stages(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], data: armrig.Dataset
) -> None:
    saved = tmp_path / "two.json"
    arguments = ["identify", str(path), "--signal", "alpha", "--nb", "3", "--nf", "3"]

    assert main([*arguments, "--structure", "oe", "--two-stage", "--save", str(saved)]) == 0

    two = armrig.two_stage(data, **ORDERS)
    np.testing.assert_allclose(armrig.load_fit(saved).theta, two.theta)
    assert "loop" not in capsys.readouterr().out


def test_oe_under_a_law_is_followed_by_bj(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["identify", str(path), "--signal", "alpha", "--nb", "3", "--nf", "3"]

    assert main([*arguments, "--structure", "oe"]) == 0

    said = capsys.readouterr()
    assert said.out.startswith(f"C{NAMED[1:]}: coloured noise in the loop biases this estimate")
    line = "--structure bj --nb 3 --nc 1 --nd 1 --nf 3 --nk 1 --signal alpha --save model.json"
    assert line in said.err.splitlines()[-1]


def test_bj_under_a_law_is_compared_with_the_model_of_the_design(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The law of another model, or of a file that has changed, is followed by no comparison."""
    monkeypatch.chdir(tmp_path)
    fit = armrig.oe(armrig.example_recording().dataset("alpha"), **ORDERS)
    fit.save("design.json")
    hash_ = armrig.control.plant.design_model(armrig.load_fit("design.json"), Ts=0.01).sha256
    asked = "identify run.mcap --signal alpha --structure bj --nb 3 --nf 3 --nk 1 --save bj.json"

    for of_model, follows in ((hash_, True), ("another", False)):
        design = {"model_sha256": of_model, "files": {"model": "design.json"}}
        service = VirtualService(Config(), tmp_path, seed=1)
        law = arm_law(design=design)
        request = ControlRequest(lease=LEASE, n=0, law=law, reference=R.tolist(), unmonitored=True)
        service.record(request).rename("run.mcap")
        main(asked.split())
        said = capsys.readouterr().err.splitlines()[-1]
        line = "armrig compare run.mcap --model bj.json --model design.json -o compare.png"
        assert (line in said) == follows, said


def test_check_names_the_law_and_leads_to_bj(
    path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["check", str(path), "--signal", "alpha"]) == 0

    said = capsys.readouterr()
    assert said.out.startswith(
        f"open loop (handout 3.7): FEEDBACK, known without the test: {NAMED}"
    )
    assert "--structure bj --search --signal alpha --save loop.json" in said.err.splitlines()[-1]


def test_an_export_has_reference_voltage_before_the_limits_and_limits(
    path: Path, tmp_path: Path
) -> None:
    recording, run = armrig.load(path), control_run(armrig.load(path))
    assert run is not None
    assert main(["export", str(path), str(tmp_path / "run.csv")]) == 0
    assert main(["export", str(path), str(tmp_path / "run.mat")]) == 0

    table = np.genfromtxt(tmp_path / "run.csv", delimiter=",", names=True)
    matlab = scipy.io.loadmat(tmp_path / "run.mat")
    part = armrig.load(path, start=1.0, stop=2.0).to_pandas()
    for name, values in {"r": R, "v": run.v, "is_limited": run.is_low | run.is_high}.items():
        np.testing.assert_array_equal(table[name], values)
        np.testing.assert_array_equal(matlab[name][:, 0], values)
        np.testing.assert_array_equal(part[name], values[100:200])
    assert recording.to_xarray()["v"].attrs == {"units": "V"}
    assert "v" not in armrig.example_recording().to_pandas()


def test_the_catalogue_has_the_hash_of_the_law(
    path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = armrig.example_recording().path.parent
    assert main(["ls", str(path.parent), "--json"]) == 0

    listed = json.loads(capsys.readouterr().out)
    assert LAW.sha256 in json.dumps(listed)
    assert armrig.catalogue(path.parent).columns()["law_sha256"].tolist() == [LAW.sha256]
    assert armrig.catalogue(folder).columns()["law_sha256"].tolist() == [""]


def test_a_playback_has_the_decisions(path: Path) -> None:
    run = read_run(path, 1.0, 2.0)

    streams = [message.stream for message in run.messages()]
    assert streams.count("control") == 100
    assert "control" not in {m.stream for m in read_run(armrig.example_recording().path).others}
