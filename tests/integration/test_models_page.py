"""The view Models in a browser: models are estimated, compared, saved, and drawn again."""

from __future__ import annotations

import io
import json
import shlex
from collections.abc import Callable
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import armrig
import pytest
from armrig.cli import main
from armrig_core.commands.commands import RunRequest
from armrig_core.rig.description import builtin
from armrig_daemon.config import Config, TimingTable
from armrig_daemon.service.virtual_service import LEASE, VirtualService

from tests.clients.made_recordings import of_the_arm
from tests.integration.browsing import WIDE, opened, text, until
from tests.integration.driving import bring_to_rest
from tests.integration.processes import WITHIN_S, Bench
from tests.integration.test_dashboard_page import run_step
from tests.integration.watching import Client
from tests.tools import needs

pytestmark = needs("chromium")
_SEARCH_S = 10 * WITHIN_S
_ROWS = "#model-table tbody tr"
_CURVES = "#model-curves .u-over"


def _arm(folder: Path) -> str:
    for seed in (2, 1):
        data = of_the_arm(armrig.telegraph(400, 0.05, seed=seed), seed=seed)
        path = folder / f"1-blackbox-arm{seed}-20260101T00000{seed}-0000000{seed}.mcap"
        path.write_bytes(data)
    return path.name


def _rc(folder: Path) -> str:
    config, rig = Config(timing=TimingTable(Ts=0.05)), builtin("rc")
    service = VirtualService(config, folder, seed=1, description=rig)
    u = armrig.telegraph(400, 0.3, 0.0, 4.0, seed=1)
    path = service.record(RunRequest(lease=LEASE, n=1, u=u.tolist(), experiment="blackbox-rc"))
    return path.name


def _import(folder: Path) -> str:
    data = armrig.load(folder / _arm(folder)).dataset("alpha")
    pairs = zip(data.u, data.y, strict=True)
    lines = [f"{k * 0.01:.2f},{u},{20 + 9 * y}" for k, (u, y) in enumerate(pairs)]
    (folder / "lamp.csv").write_text("\n".join(["t [s],in [V],<i>temp</i> [degC]", *lines]))
    table, file = str(folder / "lamp.csv"), folder / "lamp.mcap"
    names = ["--input", "in", "--signal", "<i>temp</i>"]
    assert main(["import", table, *names, "-o", str(file)]) == 0
    return file.name


def facts(command: str) -> dict[str, Any]:
    """Return the JSON of a command line."""
    program, *words = shlex.split(command)
    printed = io.StringIO()
    with redirect_stdout(printed):
        assert (program, main([*words, "--json"])) == ("armrig", 0)
    return dict(json.loads(printed.getvalue()))


def open_models(page: Any, file: str) -> None:
    """Show the view Models with a recording."""
    page.keyboard.press("m")
    page.wait_for_selector("#model-hand form")
    page.select_option("[data-key=estimation]", file)
    until(page, lambda: page.is_enabled("#model-starts button"))


def wait_for_rows(page: Any, count: int) -> None:
    """Wait until the table has this number of models, all of them estimated."""
    until(page, lambda: page.locator(_ROWS + "[data-state=done]").count() == count)


def numbers_of_rows(page: Any) -> list[list[str]]:
    """Return the numbers of each row as text."""
    rows = page.locator(_ROWS).all()
    return [row.locator("td.n").all_text_contents() for row in rows]


def press(page: Any, name: str) -> None:
    """Press the button of a name."""
    page.get_by_role("button", name=name, exact=True).first.click()


@pytest.mark.parametrize(
    "make_file",
    [
        _import,
        pytest.param(_arm, marks=pytest.mark.exhaustive),
        pytest.param(_rc, marks=pytest.mark.exhaustive),
    ],
)
def test_a_model_is_found_compared_saved_reported_and_restored_by_a_reload(
    browser: Any, client: Client, served: Bench, make_file: Callable[[Path], str]
) -> None:
    folder = served.recordings
    file = make_file(folder)
    with opened(browser, client.url, WIDE) as page:
        open_models(page, file)
        press(page, "Hints: three models")
        until(page, lambda: page.locator("#model-why").inner_text())
        count = page.locator(_ROWS).count()
        assert 1 <= count <= 3
        wait_for_rows(page, count)
        _compare_with_commands(page)

        press(page, "Search")
        page.wait_for_selector("#model-cancel")
        page.wait_for_selector("#model-cancel", state="hidden", timeout=1000 * _SEARCH_S)
        assert "What the search says" in text(page, "#model-why")
        count = page.locator(_ROWS).count()
        wait_for_rows(page, count)

        first = page.locator("#model-table button.switch").first
        in_legend = page.locator("#model-legend span").count()
        first.click()
        until(page, lambda: page.locator("#model-legend span").count() == in_legend - 1)
        before = page.locator("#model-curves canvas").first.screenshot()
        page.locator(_CURVES).first.hover()
        page.mouse.wheel(0, -300)
        until(page, lambda: page.locator("#model-curves canvas").first.screenshot() != before)

        page.locator("#model-table button[data-key^=save]").first.click()
        page.locator("#model-table input").fill("chosen")
        page.keyboard.press("Enter")
        until(page, lambda: "saved as chosen.json" in text(page, "#model-table"))
        assert armrig.load_fit(folder / "chosen.json").structure
        with page.expect_download(timeout=1000 * _SEARCH_S) as download:
            press(page, "Report of the visible models")
        assert download.value.path().read_bytes().startswith(b"%PDF")

        numbers, address = numbers_of_rows(page), page.url
        page.reload()
        page.wait_for_selector(".pill.safe")
        wait_for_rows(page, count)
        assert (numbers_of_rows(page), page.url) == (numbers, address)
        assert first.get_attribute("aria-pressed") == "false"
        assert page.locator("i:has-text('temp')").count() == 0  # a name of others is text
    for path in (folder / "chosen.json", folder / file):
        path.unlink()


def _compare_with_commands(page: Any) -> None:
    """Compare the exact numbers of the table, which are its titles, with JSON of the commands."""
    for row in page.locator(_ROWS).all():
        row.locator("summary").click()
        told = facts(row.locator("pre").first.inner_text())
        titles = [one.get_attribute("title") for one in row.locator("td.n div").all()]
        simulated, _, _, loss = (float(title.split(":")[0]) for title in titles)
        assert loss == told["loss"]
        assert simulated == told.get("validation", {"fit_percent": simulated})["fit_percent"]


def test_a_stop_ends_a_run_during_a_search(browser: Any, client: Client, served: Bench) -> None:
    file = _arm(served.recordings)
    for stop in ("space bar", "button"):
        with opened(browser, client.url) as page:
            run_step(page, served)
            open_models(page, file)
            press(page, "Search")
            until(page, lambda: "of" in page.locator("#model-left").inner_text())
            if stop == "button":
                page.click("#stop")
            else:
                page.keyboard.press("Space")
            until(page, lambda: served.volts() == 0.0)
            assert page.is_visible("#model-progress")
            page.click("#model-cancel")
            until(page, lambda: "cancelled" in page.locator("#model-why").inner_text())
            bring_to_rest(served)


def test_rows_of_two_pages_are_apart_and_a_spoilt_address_loses_nothing(
    browser: Any, client: Client, served: Bench
) -> None:
    file = _arm(served.recordings)
    with opened(browser, client.url) as page:
        open_models(page, file)
        press(page, "Estimate")
        wait_for_rows(page, 1)
        until(page, lambda: "models=" in page.url)
        address = page.url
        with opened(browser, client.url) as other:
            open_models(other, file)
            assert other.locator(_ROWS).count() == 0
        with opened(browser, client.url + "&view=models&models=abc") as spoilt:
            until(spoilt, lambda: "cannot be read" in "".join(spoilt.evaluate("window.notices")))
            assert spoilt.is_enabled("#tab-models")
        page.fill("#model-hand input", "90")
        press(page, "Estimate")
        until(page, lambda: page.locator(_ROWS + "[data-state=failed]").count() == 1)
        assert page.locator(_ROWS + "[data-state=done]").count() == 1
        (served.recordings / file).unlink()
        with opened(browser, address) as late:
            until(late, lambda: "no recording" in text(late, "#model-table"))
