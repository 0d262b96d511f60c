"""Run in control: r in the plot of what follows it, the limits of its law, and its shares."""

from __future__ import annotations

from math import degrees, inf
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from armrig.dashboard.bins import signals_of
from armrig.dashboard.control_feed import ControlFeed, Panel, RunLaw, law_of_run, panel_of
from armrig.dashboard.feed import Feed
from armrig_core.control.control_law import ControlLaw, LawOutput, Reference
from armrig_core.rig.description import shipped
from msgspec.structs import replace

from tests.clients.fake_daemon import FakeDaemon
from tests.core.control.laws import arm_law

ARM = shipped("arm")
SPEED = arm_law(hi=3.2)
HEATER = ControlLaw(
    Ts_us=1_000_000,
    input="power",
    outputs=(LawOutput(name="T1", unit="degC", y0=33.0),),
    reference=Reference(name="T1", unit="degC", low=23.0, high=60.0),
    A=(),
    B=(),
    C=(),
    D=0.1,
    x0=(),
)


def decision(k: int, r: float = 2.0, **changes: Any) -> Any:
    """Return a decision of the stream `control`, 10 ms after the one before."""
    bits = {"is_low": False, "is_high": False, "is_slewed": False, "predicted": 0}
    return SimpleNamespace(k=k, t_host_ns=1_000_000_000 + 10_000_000 * k, r=r, **bits | changes)


def state(phase: str, k: int) -> Any:
    return SimpleNamespace(phase=phase, t_host_ns=1_000_000_000 + 10_000_000 * k)


def named(name: str, unit: str) -> ControlLaw:
    return replace(SPEED, reference=Reference(name=name, unit=unit, low=0.0, high=5.0))


@pytest.mark.parametrize(
    ("law", "panel"),
    [
        (SPEED, {"key": "velocity", "unit": "°/s", "scale": degrees(1)}),
        (named("alpha", "rad"), {"key": "alpha", "unit": "°", "scale": degrees(1)}),
        (
            named("theta_1", "rad"),
            {"key": "theta_1", "unit": "°", "scale": degrees(1), "is_turning": True},
        ),
        (named("alpha_rate", "rad/s"), {"below": "alpha", "unit": "rad/s", "span": 5.0}),
        (named("velocity", "V"), {"below": "theta_1", "unit": "V", "span": 5.0}),
        (named("effort", "V"), {"below": "theta_1", "unit": "V", "span": 5.0}),
    ],
)
def test_r_is_in_the_plot_of_the_variable_that_follows_it(
    law: ControlLaw, panel: dict[str, Any]
) -> None:
    """Or in a plot of its own, if nothing on the page is that variable."""
    common = {"law": law.sha256, "name": law.reference.name, "limits": (-inf, 3.2)}

    assert panel_of(law, ARM, signals_of(ARM)) == Panel(**common, **panel)


def test_r_of_a_heater_is_in_the_plot_of_its_temperature() -> None:
    heater = shipped("heater")

    panel = panel_of(HEATER, heater, signals_of(heater))

    assert (panel.key, panel.unit, panel.limits) == ("T1", "°C", (-inf, inf))


def control_feed(law: ControlLaw, ks: range, **changes: Any) -> ControlFeed:
    """Return a feed with decisions of a law."""
    feed = ControlFeed()
    feed.add([decision(k, **changes) for k in ks], 300.0)
    feed.take_law(RunLaw(law, is_own=False), ARM, signals_of(ARM))
    return feed


def test_rows_of_r_have_the_unit_and_the_turn_of_their_plot() -> None:
    turned = control_feed(named("theta_1", "rad"), range(3), r=7.0)

    assert turned.rows()[:, 1:] == pytest.approx(degrees(7.0) % 360)
    assert turned.rows()[:, 0] == pytest.approx([1.0, 1.01, 1.02])
    assert control_feed(SPEED, range(3)).rows()[:, 1] == pytest.approx(degrees(2.0))


def test_decisions_that_arrive_twice_count_once() -> None:
    feed = control_feed(SPEED, range(4), is_high=True)
    feed.add([decision(k) for k in range(8)], 300.0)

    found: Any = feed.facts(is_going=False)
    assert found["shares"] == "input at its limit in 50 % of samples"
    assert feed.rows().shape == (8, 3)


def test_the_limits_of_a_law_are_in_force_while_its_run_is_in_progress() -> None:
    feed = control_feed(SPEED, range(4))
    going: Any = feed.facts(is_going=True)
    ended: Any = feed.facts(is_going=False)

    assert going["panel"].limits == (-inf, 3.2)
    assert ended["panel"].limits == (-inf, inf)


def test_another_law_begins_without_the_reference_of_the_previous_law() -> None:
    feed = control_feed(SPEED, range(4))
    seen = feed.pieces
    feed.begin(decision(100).t_host_ns)
    feed.add([decision(k, predicted=1) for k in range(100, 103)], 300.0)
    feed.take_law(RunLaw(named("alpha", "rad"), is_own=False), ARM, signals_of(ARM))

    assert feed.rows(seen)[:, 0] == pytest.approx([2.0, 2.01, 2.02])
    found: Any = feed.facts(is_going=True)
    assert found["panel"].key == "alpha"
    assert found["shares"].endswith("0 % of samples, 3 decisions without the newest sample")


def test_the_controller_of_a_client_has_deadlines_and_a_plot_of_its_own() -> None:
    feed = ControlFeed()
    feed.add([decision(k, predicted=k // 2) for k in range(5)], 300.0)
    feed.take_law(RunLaw(None, is_own=True), ARM, signals_of(ARM))

    assert feed.facts(is_going=False) == {"panel": Panel(), "shares": "2 of 4 deadlines missed"}


def test_the_law_is_looked_for_until_its_recording_can_be_read() -> None:
    feed = Feed()
    feed.take_status(FakeDaemon("there").status())
    laws = [None, None, SPEED]
    feed.add_states([state("armed", 0), state("active", 1)])
    feed.add_decisions([decision(k, predicted=1) for k in range(4)])
    looked = []
    while feed.control() is None:
        feed._control._looked_s = -inf
        feed.look_for_law(lambda: looked.append(1) or laws.pop(0))  # type: ignore[func-returns-value]
    feed.look_for_law(lambda: pytest.fail("the law is known"))

    assert len(looked) == 3
    found: Any = feed.control()
    assert found["panel"].key == "velocity"
    assert found["shares"].endswith("3 decisions without the newest sample")  # since the start


def test_a_run_without_a_readable_recording_has_a_plot_for_r() -> None:
    feed = ControlFeed()
    feed.add([decision(0)], 300.0)
    for _ in range(12):
        assert feed.facts(is_going=True) is None
        feed.take_law(None, ARM, signals_of(ARM))

    found: Any = feed.facts(is_going=True)
    assert found["panel"] == Panel()


def test_old_decisions_are_forgotten() -> None:
    feed = control_feed(SPEED, range(2))
    feed.add([decision(40_000)], 300.0)

    assert feed.rows()[:, 0] == pytest.approx([401.0])
    feed.forget()
    assert (feed.rows().size, feed.facts(is_going=True)) == (0, None)


def test_a_file_that_is_no_recording_names_no_law(tmp_path: Path) -> None:
    daemon = FakeDaemon("there")
    daemon.recording = str(tmp_path / "a.mcap")
    (tmp_path / "a.mcap").write_bytes(b"x")

    assert law_of_run(daemon.status()) is None
    assert law_of_run(None) is None
