"""Two described rigs from the recording to the report: an RC circuit, and a heater."""

from __future__ import annotations

import dataclasses
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import armrig
import msgspec
import numpy as np
import pytest
from armrig.cli import main
from armrig.cli.identify import _experiment, _options
from armrig.dashboard.experiments import ExperimentRequest, previewed
from armrig.dashboard.feed import Feed
from armrig.dashboard.stream import live_facts, rig_facts
from armrig.dashboard.study_of_one import csv, facts, identified
from armrig.excitation import telegraph
from armrig.recordings.overview import overview
from armrig.recordings.usability import doubts_of_pair
from armrig_core.commands.commands import RunRequest
from armrig_core.errors import InputError
from armrig_core.rig.description import Description, builtin, read_description
from armrig_daemon.config import Config, TimingTable
from armrig_daemon.emulator.device import Device
from armrig_daemon.service.virtual_service import LEASE, VirtualService
from msgspec.structs import replace

from tests.clients.fake_daemon import FakeDaemon
from tests.clients.made_recordings import sample

OWN_EQUATIONS = """
import armrig
model = armrig.Ode(lambda t, x, u, p: [u[0] - x[0] / 50],
                   output=lambda t, x, u, p: [23 + x[0], 23 + 0 * x[0]],
                   states=["T"], parameters={})
"""
ARM_WORDS = ("chassis", "theta_1", "alpha", "J_1", "dead band", "motor")


def recordings(folder: Path, rig: str, Ts: float, N: int, a: float) -> list[Path]:
    """Record two telegraph signals of a described rig in virtual time."""
    described = builtin(rig)
    service = VirtualService(
        Config(timing=TimingTable(Ts=Ts)),
        folder,
        seed=1,
        switch_on=partial(Device, description=described),
        description=described,
    )
    inputs = [telegraph(N, a, 0.5, 4.5, seed=seed).tolist() for seed in (1, 2)]
    return [
        service.record(RunRequest(lease=LEASE, n=1, u=u, experiment="blackbox")) for u in inputs
    ]


@pytest.fixture(scope="module")
def rc(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return recordings(tmp_path_factory.mktemp("rc"), "rc", 0.01, 3000, 0.1)


@pytest.fixture(scope="module")
def heater(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return recordings(tmp_path_factory.mktemp("heater"), "heater", 1.0, 400, 0.02)


def test_the_poles_of_the_circuit_are_found_within_their_deviations(rc: list[Path]) -> None:
    fit = armrig.oe(armrig.load(rc[0]).dataset(), nb=2, nf=2)

    figures = fit.summary().figures
    order = np.argsort(figures.poles.real)
    apart = np.abs(figures.poles[order] - [-15.0, -8.0])
    assert fit.output == "y"
    assert np.all(apart < 4 * figures.poles_std[order])
    assert np.all(figures.poles_std < 0.1)


def test_channels_of_a_recording_have_the_names_of_the_rig(heater: list[Path]) -> None:
    recording = armrig.load(heater[0])
    signals = recording.signals()

    assert (signals.outputs, signals.inputs) == (("T1", "T2"), ("power",))
    assert recording["T2"] is recording.T2
    assert recording.valid_T1 is recording.valid
    fit = armrig.n4sid(armrig.detrend(signals), order=3)
    assert fit["T2", "power"].output == "T2"
    with pytest.raises(AttributeError, match=r"'Heater with two .*' has no theta_1: T1, T2"):
        _ = recording.theta_1


def test_no_command_speaks_of_an_arm(
    rc: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = map(str, rc)
    model = str(tmp_path / "model.json")
    commands = (
        f"info {first}",
        f"sampling {first}",
        f"hints {first}",
        f"identify {first} --structure oe --nb 2 --nf 2 --validate {second} --save {model}",
        f"validate {second} --model {model}",
        f"compare {first} {second} --model {model}",
        f"check {first}",
    )
    for command in commands:
        assert main(command.split()) == 0, command
        said = "".join(capsys.readouterr()).replace(str(tmp_path), "")
        assert not [word for word in ARM_WORDS if word in said], (command, said)


def test_the_level_of_an_output_is_reported_with_the_option_that_estimates_it(
    heater: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """Without the level, a pole at 1 takes its place."""
    orders = ["--structure", "oe", "--nb", "1", "--nf", "1"]
    for option, level in (([], True), (["--offset"], False), (["--detrend"], False)):
        assert main(["identify", str(heater[0]), *orders, *option]) == 0
        assert ("estimate a level with --offset" in capsys.readouterr().err) == level

    with_level = armrig.oe(armrig.load(heater[0]).dataset(), nb=1, nf=1, nk=16, offset=True)
    assert 100 < -1 / np.log(with_level.poles()[0].real) < 300


def test_hints_of_several_outputs_give_one_request() -> None:
    both = {"nb": 1, "integrator": False, "family": "oe", "process": "", "doubts": ()}
    heated = SimpleNamespace(**both | {"process": "P1D"}, nf=1, nk=16, nk_interval=(16, 16))
    T1 = SimpleNamespace(**both, nf=1, nk=16, nk_interval=(0, 22))
    T2 = SimpleNamespace(**both, nf=2, nk=3, nk_interval=None)

    assert _options([T1, T2], level=True) == "--structure oe --nb 2 --nf 2 --nk 16 --offset"  # type: ignore[list-item]
    assert _options([heated], level=True) == "--structure process --form P1D --offset"  # type: ignore[list-item]
    assert _options([heated, T2], level=False).startswith("--structure oe")  # type: ignore[list-item]
    assert _options([T1], level=False) == "--structure oe --nb 1 --nf 1 --nk 16"  # type: ignore[list-item]
    assert _options([T2], level=False) == "--structure oe --nb 1 --nf 2 --nk 3"  # type: ignore[list-item]


def test_the_experiment_of_a_slow_rig_is_long_and_its_input_is_held() -> None:
    slow = SimpleNamespace(Ts=50.0, settling=616.0, tau=196.0)
    arm = SimpleNamespace(Ts=0.005, settling=0.376, tau=0.0184)

    assert [*_experiment(slow).values()] == [5.0, 2000.0, " --a 0.02"]  # type: ignore[arg-type]
    assert [*_experiment(arm).values()] == [0.005, 30.0, ""]  # type: ignore[arg-type]


@pytest.mark.parametrize("command", ["greybox", "split", "report --handout -o {folder}/a.pdf"])
def test_a_command_of_the_arm_refuses_another_rig_by_its_title(
    rc: list[Path], command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*command.format(folder=tmp_path).split(), str(rc[0])]) == 1
    told = capsys.readouterr().err
    assert "is of the rig 'Two RC filters', and this command is for the arm's" in told
    assert not (tmp_path / "a.pdf").exists()


def test_a_report_of_another_rig_has_no_physical_model(rc: list[Path]) -> None:
    from armrig.report.study import study
    from armrig.report.study_sections import study_contents

    done = study([armrig.load(path) for path in rc])

    said = repr(study_contents(done, ()))
    assert done.reference is None
    assert [one.name for one in done.estimated] == ["ARMAX", "OE", "P2"]
    assert "time constant 2 [s]" in said
    assert not [word for word in ARM_WORDS if word in said]


def test_a_report_with_given_orders_fixes_no_integrator_of_a_rig_that_settles(
    rc: list[Path],
) -> None:
    from armrig.report.study import Orders, study

    done = study([armrig.load(path) for path in rc], orders=Orders(na=2, nb=2, nf=2))

    assert not any(one.model.integrator for one in done.estimated)


def test_the_page_draws_the_signals_of_the_rig_that_answers() -> None:
    """Rows of the rig that answered before are discarded."""
    feed = Feed()
    feed.add_samples([sample(k) for k in range(3)])
    of_arm = rig_facts(feed)
    status = replace(FakeDaemon("there").status(), description=builtin("heater").text.decode())

    feed.take_status(status)
    feed.add_samples([sample(3, value_0=23.04, value_1=24.0)])

    facts = msgspec.to_builtins(rig_facts(feed))
    assert [s["key"] for s in facts.pop("signals")] == ["u", "T1", "T2"]
    assert facts.pop("hash")
    suggested = facts.pop("suggested")
    assert (suggested["Ts"], suggested["seconds"]["blackbox"]) == (5.0, 2101.0)
    assert facts == {"arm": "", "body": ""}
    assert (of_arm["hash"], of_arm["arm"], of_arm["body"]) == ("", "arm", "chassis")
    news = live_facts(feed.news(), status)
    assert [row[3:] for row in news["rows"]] == [[23.04, 23.04, 24.0, 24.0]]
    assert news["newest"] == {"u": news["rows"][0][1], "T1": 23.04, "T2": 24.0}


def test_the_page_previews_and_identifies_a_described_rig(
    heater: list[Path], rc: list[Path], tmp_path: Path
) -> None:
    status = replace(FakeDaemon("there").status(), Ts=1.0)
    for name, begins in (("heater", "rehearsed on the model: T1 from 23"), ("", "not rehearsed")):
        text = builtin("heater").text.decode()
        text = text if name else text.partition("[model]")[0]
        seen = previewed(ExperimentRequest(kind="step", Ts=1.0), replace(status, description=text))
        assert seen.rehearsal.startswith(begins)
        assert not seen.deviations

    own = tmp_path / "own.toml"
    own.write_text(f'{text.partition("[model]")[0]}[model]\nfile = "own.py"\n')
    (tmp_path / "own.py").write_text(OWN_EQUATIONS)
    local = read_description(own)
    status = replace(status, description=local.text.decode())
    seen = previewed(ExperimentRequest(kind="step", Ts=1.0), status, local)
    assert seen.rehearsal.startswith("rehearsed on the model: T1 from 23 to 40.8")

    found = identified(*rc, "")
    assert found["answer"].startswith("OE(")
    assert "y to 99." in found["answer"]
    assert not [word for word in ARM_WORDS if word in repr({**found, "figures": ""})]
    shown = facts(heater[0])
    assert (shown["arm"], [*shown["curves"]]) == ("", ["u", "T1", "T2"])
    head, first, *_ = csv(heater[0], None, None).decode().splitlines()
    assert head == "t [s],u [V],T1 [degC],T2 [degC]"
    assert float(first.split(",")[2]) == pytest.approx(23.0, abs=1.0)


def test_recordings_of_different_descriptions_are_not_compared(
    rc: list[Path], heater: list[Path]
) -> None:
    first, other = armrig.load(heater[0]), armrig.load(heater[1])
    with pytest.raises(
        InputError, match=r"rig 'Two RC .*', .* of a rig 'Heater .*': no output has the same"
    ):
        list(doubts_of_pair(armrig.load(rc[0]), first))
    for old, new, why in (
        (b"per_count = 0.0076", b"per_count = 0.0075", r"T1 per_count = 0\.0076 and 0\.0075"),
        (b'"degC"', b'"K"', "T1 unit = 'degC' and 'K'"),
        (b"per_volt = 20.0", b"per_volt = 10.0", r"input per_volt = 20\.0 and 10\.0"),
    ):
        text = other.description.text.replace(old, new, 1)
        with pytest.raises(InputError, match=f"their descriptions give {why}; choose recordings"):
            list(
                doubts_of_pair(first, dataclasses.replace(other, description=Description.of(text)))
            )
    warmer = Description.of(other.description.text.replace(b"high = 70.0", b"high = 80.0"))
    assert not list(doubts_of_pair(first, dataclasses.replace(other, description=warmer)))


def test_the_advice_to_turn_the_rig_is_for_the_arm() -> None:
    u = armrig.step(200, at=50)
    y, valid = np.ones(200), np.arange(200) != 49
    valid[20:49] = False
    for name, is_arm in (("theta_1", True), ("T1", False)):
        with pytest.raises(InputError, match="record the step again") as refusal:
            armrig.step_analysis(armrig.Dataset(u=u, y=y, Ts=0.01, valid=valid, output=name))
        assert ("chassis" in str(refusal.value)) == is_arm


def test_a_model_of_the_arm_is_refused_for_another_rig(rc: list[Path]) -> None:
    with pytest.raises(InputError, match="a recording has y"):
        armrig.load(rc[0]).dataset("alpha")


def test_each_number_of_a_heater_is_in_percent(heater: list[Path], tmp_path: Path) -> None:
    recording = armrig.load(heater[0])
    data = recording.dataset("T1")

    assert (data.input, data.input_unit, data.u.max().round(0)) == ("power", "%", 90.0)
    assert recording.u.max() == pytest.approx(4.5, abs=0.01)  # the recording keeps volts
    fit = armrig.oe(data, nb=1, nf=1, nk=16, offset=True)
    assert "power [%] to T1 [degC]" in str(fit)
    assert fit["T1", "power"].nk == 16
    assert recording.to_pandas()["power"].max() == pytest.approx(90, abs=0.2)
    rows = dict(overview(recording).rows())
    assert rows["power"].endswith("% on average")


def test_simulate_refuses_the_physical_model_for_another_rig(
    heater: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    saved = tmp_path / "m.json"
    armrig.oe(armrig.load(heater[0]).dataset(), nb=1, nf=1, nk=16, offset=True).save(saved)

    assert main(["simulate", str(heater[1])]) == 1
    refused = capsys.readouterr().err
    assert main(["simulate", str(heater[1]), "--model", str(saved)]) == 0

    assert "and the physical model with its --set is the arm's: give --model JSON" in refused
    said = capsys.readouterr().out
    assert "physics" not in said
    assert "°C" in said


def test_calibrate_refuses_recordings_of_another_rig(
    heater: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", "--rest", str(heater[0]), "--turns", str(heater[1]), "--yes"]) == 1

    assert "use `armrig calibrate --point T1=A --point T1=B`" in capsys.readouterr().err


def test_a_report_says_that_the_data_show_no_orders(
    rc: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    from armrig.report.study import study
    from armrig.report.study_sections import study_contents

    def refused(data: object) -> None:
        raise InputError("u explains y at no frequency")

    monkeypatch.setattr("armrig.report.study._suggest_orders", refused)

    done = study([armrig.load(path) for path in rc])

    assert [fit.model.form.theta.size for fit in done.estimated][-1] == 4
    said = study_contents(done, []).front.warnings
    assert "The data do not show the orders: u explains y at no frequency. The models" in said[-1]
