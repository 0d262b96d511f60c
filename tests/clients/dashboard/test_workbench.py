"""Models of the page: each number is that of a command, and each model can be made again."""

from __future__ import annotations

import asyncio
import io
import json
import os
import shlex
import threading
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from contextlib import redirect_stdout
from functools import partial
from pathlib import Path
from typing import Any

import armrig
import numpy as np
import pytest
from armrig.cli import main
from armrig.dashboard import model_routes, model_search, workbench
from armrig.dashboard.app import application
from armrig.dashboard.feed import Feed
from armrig.dashboard.model_data import ModelData
from armrig.dashboard.model_routes import ModelRoutes
from armrig.estimation.request import OPTIONS
from armrig.models.structure_table import OFFERED
from msgspec.structs import replace

from tests.clients.dashboard.asking import asked
from tests.clients.fake_daemon import FakeDaemon
from tests.clients.made_recordings import manifest, of_the_arm, recorded, sample, written

OE = {"structure": "oe", "orders": {"nb": 3, "nf": 3}}
PAIR = {"file": "a.mcap", "validation": "b.mcap", "outputs": ["alpha"]}
HALVES = PAIR | {"validation": ""}
IMPORT = {"file": "mine.mcap", "validation": "", "inputs": ["in"], "outputs": ["temp"]}
PART = {"kind": "part", "start": 0.5, "stop": 5.5}
MEANS = {"kind": "means"}
STEPS = [
    {"kind": "resample", "Ts": 0.02},
    {"kind": "trend"},
    {"kind": "mask", "start": 1, "stop": 1.2},
]
TREATED = IMPORT | {"treatments": [PART, *STEPS]}
BOTH = PAIR | {"outputs": ["theta_1", "alpha"]}
OF_BOTH = {"structure": "oe", "orders": {"nb": 4, "nf": 4}, "integrator": True}


class _Routes(ModelRoutes):
    """Routes whose computations run in this process."""

    def __init__(self, folder: Path) -> None:
        feed = Feed()
        feed.status = replace(FakeDaemon("there").status(), recordings=str(folder))
        super().__init__(feed, "1")
        self.app = application(self.routes())

    async def _in_worker(self, does: Callable[..., Any], *arguments: Any) -> Any:
        return does(*arguments)

    def answer(self, path: str, **body: Any) -> tuple[int, Any]:
        status, said = asked(self.app, f"/api/models/{path}", json.dumps(body).encode())
        return status, said if said.startswith(b"%PDF") else json.loads(said)

    def value(self, path: str, **body: Any) -> Any:
        status, said = self.answer(path, **body)
        assert status == 200, said
        return said

    def refusal(self, path: str, **body: Any) -> str:
        """Return the error of a refused request: one line, which a row of the table can show."""
        status, said = self.answer(path, **body)
        assert status == 400
        assert "\n" not in said["error"]
        return str(said["error"])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a folder of two recordings of the arm, and of an imported table."""
    folder = tmp_path_factory.mktemp("models")
    u = [armrig.telegraph(600, 0.05, seed=seed) for seed in (1, 2)]
    for name, volts, seed in zip("ab", u, (1, 2), strict=True):
        written(folder, of_the_arm(volts, seed=seed), f"{name}.mcap")
    data = armrig.load(folder / "a.mcap").dataset("alpha")
    pairs = zip(data.u, data.y, strict=True)
    lines = [f"{k * 0.01:.2f},{u},{20 + 9 * y}" for k, (u, y) in enumerate(pairs)]
    (folder / "mine.csv").write_text("\n".join(["t [s],in [V],temp [degC]", *lines]))
    file, out = str(folder / "mine.csv"), str(folder / "mine.mcap")
    assert main(["import", file, "--input", "in", "--signal", "temp", "-o", out]) == 0
    return folder


@pytest.fixture
def routes(folder: Path) -> _Routes:
    """Give routes for the folder."""
    return _Routes(folder)


def _facts(command: str) -> dict[str, Any]:
    """Return the JSON of a command line."""
    program, *words = shlex.split(command)
    printed = io.StringIO()
    with redirect_stdout(printed):
        assert (program, main([*words, "--json"])) == ("armrig", 0)
    return dict(json.loads(printed.getvalue()))


@pytest.mark.parametrize(
    ("data", "request_"),
    [
        (PAIR, OE),
        (PAIR, {"structure": "bj", "orders": {"nb": 3, "nf": 3, "nc": 2}, "nk": 2}),
        (PAIR | {"treatments": [PART, MEANS]}, {"structure": "arx", "orders": {"na": 3, "nb": 3}}),
        (PAIR, {"structure": "n4sid", "orders": {"order": 3}, "weights": "moesp"}),
        (PAIR, {"structure": "process", "orders": {}, "form": "P2U"}),
        (HALVES | {"treatments": [PART]}, OE),
        (BOTH, OF_BOTH),
        (IMPORT, OE | {"offset": True}),
    ],
)
def test_each_number_of_a_row_is_that_of_its_command_line(
    routes: _Routes, folder: Path, data: dict[str, Any], request_: dict[str, Any]
) -> None:
    row = routes.value("estimate", data=data, request=request_)

    told = _facts(row["command"])
    assert row["loss"] == told["loss"]
    assert row["structure"] == told["structure"]
    assert {*told["warnings"]} <= {*row["warnings"]}
    model = f"row-{len([*folder.iterdir()])}"
    file = routes.value("save", data=data, request=request_, name=model)["file"]
    judged = _facts(routes.value("open", file=file, data=data)["command"])
    fits = [row["fit_simulated"][name] for name in data["outputs"]]
    ahead = [row["fit_predicted"][name] for name in data["outputs"]]
    one = len(fits) == 1
    assert judged["fit_percent"] == (fits[0] if one else fits)
    assert judged["ahead"][0]["fit_percent"] == (ahead[0] if one else ahead)
    p = {verdict["about"]: verdict["p"] for verdict in row["residuals"]}
    assert p["white"] == judged["p_white"]
    assert p["missing dynamics"] == judged["p_no_dynamics_missing"]
    assert p["feedback"] == judged["p_no_feedback"]


@pytest.mark.parametrize(
    ("data", "structure"), [*((PAIR, name) for name in OFFERED), (TREATED, "arx"), (TREATED, "tf")]
)
def test_the_lines_of_python_give_the_same_model(
    routes: _Routes, folder: Path, data: dict[str, Any], structure: str
) -> None:
    more = {"form": "P2"} if structure == "process" else {}
    orders = {x: 2 for x in OFFERED[structure].orders if x != "zeros"}  # type: ignore[index]
    request_ = {"structure": structure, "orders": orders, **more}
    row = routes.value("estimate", data=data, request=request_)

    names: dict[str, Any] = {}
    exec(row["python"], names)

    assert [q.loss for q in names["fit"].quality] == [row["loss"]]
    assert bool(row["command"]) == (data is PAIR)


def test_a_model_of_two_outputs_has_a_denominator_in_common(routes: _Routes) -> None:
    row = routes.value("estimate", data=BOTH, request=OF_BOTH)

    assert row["request"]["shared"]
    assert row["request"]["integrator"] == ["theta_1"]
    names: dict[str, Any] = {}
    exec(row["python"], names)
    assert [q.loss for q in names["fit"].quality] == row["loss"]


def test_the_data_name_their_signals_units_structures_and_the_validation_recording(
    tmp_path: Path,
) -> None:
    for day, name in enumerate("ba", 1):
        details = {"validation_of": "run-a"} if name == "b" else {}
        started = f"2026-03-0{day}T10:00:00+00:00"
        about = manifest(run_id=f"run-{name}", started=started, details=details)
        samples = [sample(k, value_0=3.0 + 0.1 * (k % 7)) for k in range(60)]
        written(tmp_path, recorded(samples, manifest=about), f"{name}.mcap")
    routes = _Routes(tmp_path)

    found = routes.value("data", data={"file": "a.mcap"})

    assert found["data"] == {
        "file": "a.mcap",
        "validation": "b.mcap",
        "inputs": ["u"],
        "outputs": ["theta_1"],
        "treatments": [],
    }
    assert (found["N"], found["Ts"], found["judged"]) == (60, 0.01, "b.mcap")
    assert found["inputs"] == [{"name": "u", "unit": "V"}]
    assert found["outputs"][:2] == [
        {"name": "theta_1", "unit": "rad"},
        {"name": "alpha", "unit": "rad"},
    ]
    assert [*found["verdict"]] == ["usable", "summary"]
    for row in found["structures"]:
        options = {option["name"]: option for option in row["options"]}
        assert {*options} == {*OFFERED[row["name"]].options} & {*OPTIONS}
        assert row["has_nk"] != OFFERED[row["name"]].continuous
    kinds = {one["name"]: one["kind"] for row in found["structures"] for one in row["options"]}
    assert {kinds[name] for name in ("offset", "integrator", "stable", "shared")} == {"flag"}
    assert (kinds["weights"], kinds["form"], kinds["delay"]) == ("choice", "text", "text")
    # A recording is found by its hash, too.
    assert routes.value("data", data={"file": found["sha256"][:12]})["data"] == found["data"]


def test_an_import_lists_all_columns_of_its_table(routes: _Routes) -> None:
    found = routes.value("data", data={"file": "mine.mcap"})

    assert found["data"]["inputs"] == ["in"]
    assert found["data"]["outputs"] == ["temp"]
    assert {"name": "temp", "unit": "degC"} in found["outputs"]
    assert found["judged"] == workbench.JUDGED_BY_HALF


def test_the_hints_are_at_most_three_requests_of_the_recommended_structures(
    routes: _Routes, folder: Path
) -> None:
    found = routes.value("hints", data=PAIR)

    data = armrig.load(folder / "a.mcap").dataset("alpha")
    hints = armrig.structure_hints(data)
    orders = [(r["orders"]["nb"], r["orders"]["nf"], r["nk"]) for r in found["requests"]]
    assert orders == [(s.nb, s.nf, s.nk) for s in hints.structures]
    assert found["why"] == hints.explain()


@pytest.mark.parametrize("kind", ["output", "residuals", "poles", "frequency", "step"])
@pytest.mark.parametrize(
    ("data", "request_"), [(PAIR, OE), (BOTH, OF_BOTH), (IMPORT, OE)], ids=["arm", "both", "import"]
)
def test_a_plot_has_a_curve_of_each_model_and_the_hashes_of_its_recordings(
    routes: _Routes, kind: str, data: dict[str, Any], request_: dict[str, Any]
) -> None:
    wrong = {"structure": "oe", "orders": {"nb": 300, "nf": 3}}

    found = routes.value("plot", data=data, requests=[request_, wrong, request_], kind=kind)

    assert "nb=300" in found["note"]
    assert len(found["sha256"]) == (1 if data is IMPORT else 2)
    assert found["panels"]
    for panel in found["panels"]:
        assert {0, 2} <= {curve["model"] for curve in panel["series"]} <= {None, 0, 2}
        for curve in panel["series"]:
            sizes = {len(curve[key]) for key in ("x", "y", "least", "low") if key in curve}
            assert len(sizes) == 1


def test_the_drawn_output_is_the_comparison_of_the_command(routes: _Routes, folder: Path) -> None:
    found = routes.value("plot", data=PAIR, requests=[OE], kind="output", horizon=5)

    fit = armrig.oe(armrig.load(folder / "a.mcap").dataset("alpha"), nb=3, nf=3)
    data = armrig.load(folder / "b.mcap").dataset("alpha")
    [row] = armrig.compare(data, fit, horizon=5)
    [measured, simulated] = found["panels"][0]["series"]
    np.testing.assert_allclose(simulated["least"], row.y, atol=1e-8)
    np.testing.assert_allclose(measured["largest"], data.y, atol=1e-8)


def test_a_saved_model_is_opened_with_its_data_and_drawn_without_an_estimate(
    routes: _Routes, folder: Path
) -> None:
    data = PAIR | {"treatments": [MEANS]}
    row = routes.value("estimate", data=data, request=OE)
    saved = routes.value("save", data=data, request=OE, name="mine")

    found = routes.value("open", file="mine.json")

    assert saved == {"file": "mine.json"}
    assert armrig.load_fit(folder / "mine.json").heading == "OE(nb=3, nf=3, nk=1)"
    assert found["request"] == {"file": "mine.json"}
    assert (found["data"]["file"], found["data"]["treatments"]) == ("a.mcap", [MEANS])
    judged = routes.value("open", file="mine.json", data=data)
    for key in ("loss", "fit_simulated", "fit_predicted", "residuals", "name"):
        assert judged[key] == row[key]
    told = _facts(judged["command"])
    assert told["fit_percent"] == judged["fit_simulated"]["alpha"]
    assert routes.value("plot", data=data, requests=[found["request"]], kind="poles")["panels"]
    text = routes.refusal("save", data=data, request=OE, name="mine")
    assert text == "mine.json: exists already; give another name"


def test_a_report_contains_the_chosen_models(
    routes: _Routes, monkeypatch: pytest.MonkeyPatch
) -> None:
    from armrig.report import document

    studies: list[Any] = []

    def typeset(study: Any, path: Path) -> Path:
        studies.append(study)
        path.write_bytes(b"%PDF")
        return path

    monkeypatch.setattr(document, "report", typeset)

    assert routes.value("report", data=BOTH, requests=[OF_BOTH]) == b"%PDF"
    models = [OE, OE | {"offset": True}]
    assert routes.value("report", data=HALVES, requests=models) == b"%PDF"
    both, halves = studies
    assert [study.output for study in (both, *both.others)] == ["theta_1", "alpha"]
    assert [m.name for m in halves.estimated] == ["OE[3 3 1]", "OE[3 3 1], model 2"]
    assert (both.halves, halves.halves) == (False, True)


@pytest.mark.parametrize(
    ("path", "body", "why"),
    [
        ("estimate", {"data": PAIR | {"file": "gone.mcap"}, "request": OE}, "there is no such"),
        ("estimate", {"data": PAIR | {"file": "0" * 12}, "request": OE}, "no recording with the"),
        ("estimate", {"data": PAIR | {"outputs": ["T"]}, "request": OE}, "a recording has"),
        ("estimate", {"data": PAIR | {"inputs": ["v"]}, "request": OE}, "the input of a.mcap is u"),
        (
            "estimate",
            {"data": PAIR, "request": {"structure": "oe", "orders": {"na": 2}}},
            "na goes",
        ),
        ("estimate", {"data": PAIR, "request": OE | {"nk": -1}}, "nk"),
        ("estimate", {"data": PAIR, "request": OE | {"structure": "x"}}, "Invalid enum"),
        ("estimate", {"data": BOTH, "request": OE | {"structure": "tf"}}, "goes with"),
        ("estimate", {"data": PAIR, "request": {"structure": "process", "orders": {}}}, "a form"),
        ("estimate", {"data": PAIR, "request": {"file": "../a.json"}}, "there is no such file"),
        ("estimate", {"request": OE}, "names no data"),
        ("data", {"data": PAIR | {"treatments": [{"kind": "x"}]}}, "Invalid enum"),
        (
            "data",
            {"data": PAIR | {"treatments": [PART | {"stop": 0.1}]}},
            "start < stop is needed",
        ),
        ("data", {"data": PAIR | {"treatments": [{"kind": "resample"}]}}, "needs Ts"),
        ("plot", {"data": PAIR, "requests": [OE] * 200}, "200 models: choose 1 to 50"),
        ("report", {"data": PAIR, "requests": []}, "0 models"),
        ("save", {"data": PAIR, "request": OE, "name": "../x"}, "without /"),
        ("open", {"file": "none.json"}, "there is no such file"),
    ],
)
def test_bad_input_is_refused_in_a_line(
    routes: _Routes, path: str, body: dict[str, Any], why: str
) -> None:
    assert why in routes.refusal(path, **body)


@pytest.mark.parametrize(
    ("failure", "said"), [(BrokenProcessPool, "try again"), (MemoryError, "memory")]
)
def test_after_a_failure_of_the_process_the_next_request_is_answered(
    routes: _Routes, failure: type[Exception], said: str
) -> None:
    answers = routes._in_worker

    async def dies(*_: Any) -> Any:
        raise failure

    routes._in_worker = dies  # type: ignore[method-assign]
    status, told = routes.answer("data", data=PAIR)
    routes._in_worker = answers  # type: ignore[method-assign]

    assert (status, said in told["error"]) == (500, True)
    assert routes.answer("data", data=PAIR)[0] == 200


class _Sent(list[Any]):
    """Messages of a search in this process."""

    send = list.append


def test_a_search_reports_its_progress_and_the_requests_of_the_best_models(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(model_search, "begin_worker", lambda: None)
    monkeypatch.setattr(os, "nice", lambda _: 0)
    quick = partial(armrig.search, families=["oe"], orders=[2, 3])
    monkeypatch.setattr(model_search, "search", quick)
    data = ModelData(file="a.mcap", validation="b.mcap", outputs=("alpha",))
    sent = _Sent()

    model_search.run_search(sent, folder, data)  # type: ignore[arg-type]

    *progress, last = sent
    found = quick(*(armrig.load(folder / name).dataset("alpha") for name in ("a.mcap", "b.mcap")))
    assert progress[0] == {"done": 0, "of": progress[0]["of"], "seconds_left": None}
    assert progress[-1] == {"done": progress[0]["of"], "of": progress[0]["of"], "seconds_left": 0}
    assert last["said"] == found.explain()
    assert last["requests"][0]["orders"] == {x: found.fit.orders[x] for x in ("nb", "nf")}
    sent.clear()
    model_search.run_search(sent, folder, replace(data, outputs=("x",)))  # type: ignore[arg-type]
    assert "a recording has" in sent[-1]["error"]


def _wait(sending: Any, *_: Any) -> None:
    sending.send({"done": 1, "of": 2, "seconds_left": 1.0})
    threading.Event().wait()


def _die(*_: Any) -> None:
    os._exit(9)


def test_a_search_is_cancelled_by_its_page_and_a_killed_search_is_reported(
    routes: _Routes, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = ModelData(file="a.mcap", validation="b.mcap")

    async def lines_of(page: str, *, cancelled: bool) -> list[Any]:
        lines = []
        async for line in routes._search_lines(page, data):
            lines.append(json.loads(line))
            if cancelled and len(lines) == 1:
                routes._end_search("other")
                assert [*routes._searches] == [page]
                routes._end_search(page)
        return lines

    monkeypatch.setattr(model_routes, "run_search", _wait)
    first, last = asyncio.run(lines_of("mine", cancelled=True))
    monkeypatch.setattr(model_routes, "run_search", _die)
    [died] = asyncio.run(lines_of("mine", cancelled=False))

    assert (first["done"], last) == (1, {"error": "the search was cancelled"})
    assert "try again" in died["error"]
    assert routes._searches == {}
