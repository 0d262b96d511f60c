"""The dashboard as a person meets it: in a browser, over a real daemon and its emulated rig."""

from __future__ import annotations

import itertools
import os
import re
import signal
from pathlib import Path
from typing import Any

import pytest
from armrig.dashboard.serving import DashboardSettings, dashboard
from armrig_core.rig.description import path_of

from tests.clients import made_recordings
from tests.core.control.laws import arm_law, arm_monitor
from tests.integration.browsing import KEEP_NOTICES, PHONE, WIDE, opened, text, until
from tests.integration.driving import bring_to_rest
from tests.integration.processes import Bench, freeze
from tests.integration.watching import Client, begin, recorded, watched
from tests.tools import needs

pytestmark = needs("chromium")

_CONNECTIONS = 6
MARKUP = "<img src=x onerror=document.title='owned'>"
LONG_WORD = "W" * 500


def show_step(page: Any, seconds: str = "20") -> None:
    """Choose a step, and have it shown."""
    page.select_option("#kind", "step")
    page.fill("#field-seconds", seconds)
    page.fill("#field-low", "1")
    page.fill("#field-high", "4")
    page.click("#show")
    page.wait_for_selector("#preview:not([hidden])")


def run_step(page: Any, bench: Bench, seconds: str = "20") -> None:
    """Run a step from the page, and wait until the motor is driven."""
    show_step(page, seconds)
    until(page, lambda: page.is_enabled("#run") or page.is_visible("#fault"))
    assert page.is_enabled("#run"), text(page, "#fault")
    page.evaluate("document.querySelector('#running-text').className = ''")  # of before
    page.click("#run")
    until(page, lambda: bench.volts() > 0 or page.get_attribute("#running-text", "class"))
    assert bench.volts() > 0, text(page, "#running-text")


def has_noticed(page: Any, words: str) -> bool:
    """Return whether a notice with these words was shown; the next notice may have replaced it."""
    return words in "\n".join(page.evaluate("window.notices"))


def is_in_view(page: Any, selector: str) -> bool:
    """Return whether an element is in the window, below the top lines."""
    box, size = page.locator(selector).first.bounding_box(), page.viewport_size
    top = page.locator("#top").bounding_box()
    least = 0 if page.locator(f"#top {selector}").count() else top["y"] + top["height"]
    return bool(least <= box["y"] and box["y"] + box["height"] <= size["height"])


@pytest.mark.exhaustive
def test_the_page_previews_an_experiment_before_it_runs(
    browser: Any, client: Client, served: Bench
) -> None:
    with opened(browser, client.url) as page:
        show_step(page, "2")
        assert "the chassis turns" in text(page, "#preview-lines")
        page.fill("#field-high", "3.5")
        assert not page.is_enabled("#run")
        assert served.voltage_changes()[-1][1] == 0.0
        run_step(page, served, "2")
        page.wait_for_selector("#recording:not([hidden])")
        page.wait_for_selector("#look:not([hidden])")
        assert "is recorded" in text(page, "#running-text")
        assert not page.is_enabled("#run")


def test_the_run_button_is_next_to_preview_and_a_run_stays_in_view(
    browser: Any, client: Client, served: Bench
) -> None:
    with opened(browser, client.url, {"width": 1024, "height": 700}) as page:
        show_step(page)
        preview, run = (page.locator(button).bounding_box() for button in ("#show", "#run"))
        assert preview["y"] == run["y"]
        assert is_in_view(page, "#run")
        run_step(page, served)
        until(page, lambda: re.search(r": \d+ s left", text(page, "#recording-text")))
        for part in ("#recording-text", "#running-text", "#value-u", "#value-theta_1"):
            assert is_in_view(page, part), part
        assert is_in_view(page, "#charts .u-wrap")
        assert is_in_view(page, "#charts .chart:nth-child(2) .u-wrap")
        bring_to_rest(served)


def test_the_page_of_a_heater_has_its_signals_and_nothing_of_the_arm(
    browser: Any, bench: Bench
) -> None:
    bench.configure(more=f'[rig]\nfile = "{path_of(Path("heater"))}"')
    bench.emulate()
    bench.serve()
    with watched(bench) as client, opened(browser, client.url) as page:
        until(page, lambda: "°C" in text(page, "#value-T2"))
        assert page.locator("#charts .chart").count() == 3
        assert not page.is_visible("#arm-card")
        suggested = {name: page.input_value(f"#field-{name}") for name in ("Ts", "seconds", "high")}
        assert suggested == {"Ts": "5", "seconds": "2101", "high": "4.5"}
        page.select_option("#kind", "step")
        page.fill("#field-Ts", "0.01")
        page.fill("#field-at", "0.5")
        run_step(page, bench, "2")
        assert "T1 from 23" in text(page, "#running-told")
        page.click("#look:visible")
        page.wait_for_selector("#curves canvas")
        assert page.locator("#curves .chart").count() == 3
        assert page.locator("#output option").all_text_contents() == ["T1", "T2", "T1 and T2"]


# With and without the notice in one call, because other texts, as the timing, change their length.
_PLACES_WITH_AND_WITHOUT_NOTICE = """[false, true].map((isHidden) => {
  document.getElementById("notice").hidden = isHidden;
  return ["plots", "show", "tab-live"].map((id) => document.getElementById(id).offsetTop);
})"""
_FONT_PIXELS = "(id) => parseFloat(getComputedStyle(document.getElementById(id)).fontSize)"
# From the top to the bottom of the projector view, each part ends before the next, in the window.
_OVERLAPPING_PARTS = """() => {
  const parts = [...document.querySelectorAll("#top, #fault, #charts .chart")];
  const boxes = parts.map((part) => part.getBoundingClientRect());
  const ends = [...boxes.slice(1).map(({ top }) => top), innerHeight];
  const isOver = ({ scrollHeight }, i) =>
    boxes[i].bottom > ends[i] + 1 || scrollHeight > boxes[i].height + 1;
  return parts.filter(isOver).map((part) => part.id || part.textContent);
}"""
# A line is red in at least a third of the pixels of a row.
_CHARTS_WITH_RED = """() => {
  const canvases = [...document.querySelectorAll("#charts canvas")];
  return canvases.flatMap((canvas, i) => {
    const { width, height } = canvas;
    const { data } = canvas.getContext("2d").getImageData(0, 0, width, height);
    const isRed = (p) => data[p] > 150 && data[p + 1] < 60 && data[p + 3] > 200;
    const rows = Array.from({ length: height }, () => 0);
    for (let k = 0; k < width * height; k += 1) rows[Math.floor(k / width)] += isRed(4 * k);
    return Math.max(...rows) > width / 3 ? [i] : [];
  });
}"""
_COVERED_CHARTS = """() => {
  const notice = document.querySelector("#notice");
  notice.hidden = false;
  const note = notice.getBoundingClientRect();
  const charts = [...document.querySelectorAll("#charts .chart")];
  const boxes = charts.map((chart) => chart.getBoundingClientRect());
  return boxes.filter((box) => box.top < note.bottom && note.top < box.bottom).length;
}"""


def test_a_notice_covers_no_chart_moves_nothing_and_takes_no_click(
    browser: Any, client: Client
) -> None:
    with opened(browser, client.url) as page:
        page.select_option("#kind", "step")
        page.fill("#field-at", "9")
        page.click("#show")
        page.wait_for_selector("#notice:not([hidden])")
        shown, hidden = page.evaluate(_PLACES_WITH_AND_WITHOUT_NOTICE)
        assert shown == hidden
        assert page.evaluate("getComputedStyle(notice.parentNode).pointerEvents") == "none"
        for size in (WIDE, {"width": 1024, "height": 700}, PHONE):
            page.set_viewport_size(size)
            page.evaluate("scrollTo(0, 0)")
            until(page, lambda: page.evaluate(_COVERED_CHARTS) == 0)


@pytest.mark.exhaustive
def test_each_button_is_large_enough_for_a_finger(browser: Any, client: Client) -> None:
    """At least 44 pixels high and wide, on a phone and on a tablet."""
    for size in (PHONE, {"width": 320, "height": 640}, {"width": 1024, "height": 768}):
        with opened(browser, client.url, size, has_touch=True, is_mobile=True) as page:
            page.click("#tab-recordings")
            page.click("#tab-live")
            for element in page.locator("button:visible, select:visible, summary:visible").all():
                box = element.bounding_box()
                assert min(box["height"], box["width"]) >= 44, element.inner_text()
            assert page.evaluate("document.documentElement.scrollWidth") <= size["width"]


@pytest.mark.exhaustive
def test_a_projector_shows_only_plots_phase_and_stop_button(browser: Any, client: Client) -> None:
    with opened(browser, client.url, WIDE) as page:
        page.click("#projector")
        for part in ("phase", "stop", "value-u"):
            assert page.is_visible(f"#{part}")
            assert page.evaluate(_FONT_PIXELS, part) >= 24
        for part in ("tab-recordings", "experiment", "timing-text", "owner"):
            assert not page.is_visible(f"#{part}")
        page.click("#projector")
        assert page.is_visible("#experiment")


def test_the_space_bar_stops_wherever_the_focus_is(
    browser: Any, client: Client, served: Bench
) -> None:
    with opened(browser, client.url) as page:
        for focus in ("#run", "#note-text", "#kind"):
            run_step(page, served)
            page.wait_for_selector(".pill.active")
            page.focus(focus)
            owner = page.input_value("#owner-name")
            page.keyboard.press("Space")
            until(page, lambda: served.volts() == 0.0)
            assert page.input_value("#owner-name") == owner
            until(page, lambda: "stopped by dashboard" in text(page, "#running-text"))
            bring_to_rest(served)


def test_a_run_in_control_shows_its_reference_until_the_space_bar_ends_it(
    browser: Any, client: Client, served: Bench
) -> None:
    """The law limits u to 3.2 V, and other files of the folder have the reason in a row."""
    files = [served.recordings / name for name in ("law.json", f"{MARKUP}.json")]
    files[0].write_bytes(arm_law(monitor=arm_monitor(), hi=3.2).text)
    files[1].write_bytes(b"{}")
    with opened(browser, client.url, color_scheme="light") as page:
        page.select_option("#kind", "control")
        until(page, lambda: f"{MARKUP}.json: no control law" in text(page, "#law-faults"))
        page.fill("#field-seconds", "60")
        page.fill("#field-r_high", "3")
        page.click("#show")
        until(page, lambda: page.is_enabled("#run"))
        page.click("#run")
        until(page, lambda: text(page, "#value-r") == "115 °/s")
        assert text(page, "#new-r-range") == "2 to 3 rad/s"
        page.fill("#new-r", "2.5")
        page.click("#new-reference button")
        until(page, lambda: text(page, "#value-r") == "143 °/s")
        page.fill("#new-r", "9")
        page.keyboard.press("Enter")
        until(page, lambda: "r = 9 was not rehearsed" in text(page, "#running-told"))
        until(page, lambda: "input at its limit in" in text(page, "#shares"))
        until(page, lambda: page.evaluate(_CHARTS_WITH_RED) == [0])
        assert page.locator("img").count() == 0
        page.keyboard.press("Space")
        until(page, lambda: served.volts() == 0.0)
        until(page, lambda: "stopped by dashboard" in text(page, "#running-text"))
        until(page, lambda: page.evaluate(_CHARTS_WITH_RED) == [])
    for file in files:
        file.unlink()


def test_a_stop_is_sent_though_tabs_use_all_connections(
    browser: Any, client: Client, served: Bench
) -> None:
    """A browser has six to a server, and each tab's stream takes one."""
    with opened(browser, client.url) as page:
        # As of other tabs, which would be slow to draw.
        asked = {"headers": {"Authorization": f"Bearer {client.token}"}}
        page.evaluate(
            "([asked, n]) => "
            "Promise.all(Array.from({length: n}, () => fetch('api/stream', asked))).then(() => 0)",
            [asked, _CONNECTIONS - 1],
        )
        begin(client, served)
        page.keyboard.press("Space")
        client.wait("run", lambda seen: "stopped by dashboard" in seen["error"])
        assert served.volts() == 0.0


def test_markup_in_a_name_is_shown_as_text(browser: Any, client: Client, served: Bench) -> None:
    for _ in range(3):  # a busy machine may end the run before
        begin(client, served, {"kind": "csv", "text": "u\n" + "1\n" * 12_000, "file": MARKUP})
        client.ask("/api/stop", {"owner": MARKUP})
        if MARKUP in client.wait("run", lambda seen: not seen["is_going"])["error"]:
            break
        bring_to_rest(served)
    (served.recordings / f"{MARKUP}.mcap").write_bytes(b"")
    with opened(browser, client.url) as page, served.rig() as other:
        other.arm(MARKUP)
        until(page, lambda: text(page, "#owner") == MARKUP)
        other.disarm()
        until(page, lambda: MARKUP in text(page, "#running-text"))
        page.click("#tab-recordings")
        until(page, lambda: MARKUP in text(page, "#table"))
        page.click("#table tbody button >> nth=0")
        page.wait_for_selector("#curves canvas")
        assert page.locator("img").count() == 0
        assert "owned" not in page.title()


@pytest.mark.exhaustive
def test_a_recording_is_identified_and_reported(
    browser: Any, client: Client, served: Bench, tmp_path: Path
) -> None:
    recorded(client, {"kind": "blackbox", "seconds": 5})
    with opened(browser, client.url) as page:
        page.keyboard.press("r")
        page.click("#table tbody button >> nth=0")
        page.wait_for_selector("#curves canvas")
        page.click("text=Identify")
        until(page, lambda: page.locator(".figures img").count() == 4, 90)
        assert "advice" in text(page, "#model")
        assert text(page, "#model > :first-child").startswith("OE(")
        until(page, lambda: is_in_view(page, "#model .answer"))
        with page.expect_download(timeout=120_000) as coming:
            page.get_by_role("button", name="Report", exact=True).click()
        coming.value.save_as(tmp_path / "report.pdf")
        until(page, lambda: is_in_view(page, "#reported .answer"))
        with page.expect_download() as coming:
            page.click("#one >> text=MCAP")
        coming.value.save_as(tmp_path / "run.mcap")
    assert (tmp_path / "report.pdf").read_bytes()[:5] == b"%PDF-"
    assert (tmp_path / "run.mcap").read_bytes()[1:5] == b"MCAP"


@pytest.mark.exhaustive
def test_the_page_fits_the_screen(browser: Any, client: Client) -> None:
    with opened(browser, client.url) as page:
        for theme, size in itertools.product(("light", "dark"), (WIDE, PHONE)):
            page.emulate_media(color_scheme=theme)
            page.set_viewport_size(size)
            until(page, lambda wanted=theme: page.get_attribute("html", "data-theme") == wanted)
            for tab in ("#tab-live", "#tab-recordings"):
                page.click(tab)
                page.evaluate("scrollTo(0, document.body.scrollHeight)")
                until(page, lambda wide=size["width"]: page.evaluate(_WIDTH) <= wide)
                box = page.locator("#stop").bounding_box()
                assert 0 <= box["y"] <= size["height"] - box["height"]
                assert box["height"] >= (44 if size is PHONE else 36)


_WIDTH = "document.documentElement.scrollWidth"


def test_long_words_of_a_recording_are_broken(browser: Any, client: Client, served: Bench) -> None:
    of = made_recordings.manifest(experiment=LONG_WORD)
    note = made_recordings.note(100, LONG_WORD, LONG_WORD[:80])
    data = made_recordings.recorded([*map(made_recordings.sample, range(300)), note], manifest=of)
    for name in ("a", "b"):
        made_recordings.written(served.recordings, data, f"{name}{LONG_WORD[:200]}.mcap")
    with opened(browser, client.url, WIDE) as page:
        page.click("#tab-recordings")
        page.click(f"#table tbody tr:has-text('{LONG_WORD}') button")
        page.wait_for_selector("#curves canvas")
        for size in (WIDE, PHONE):
            page.set_viewport_size(size)
            # The charts get their new width after the layout.
            until(page, lambda most=size["width"]: page.evaluate(_WIDTH) <= most)


def test_the_address_on_a_browser_command_line_opens_once(browser: Any, served: Bench) -> None:
    """Other users can read it in `ps`."""
    with dashboard(DashboardSettings(connect=served.endpoint)) as found:
        code = found.browser_url.partition("#once=")[2]
        with opened(browser, found.browser_url) as page:
            assert page.url == found.url
            page.reload()
            page.wait_for_selector(".pill.safe")
        status, told = Client(found.url).ask("/api/token", {}, Authorization=f"Bearer {code}")
        late = browser.new_page()
        late.add_init_script(KEEP_NOTICES)
        late.goto(found.browser_url)
        until(late, lambda: has_noticed(late, "terminal"))
        late.close()

    assert code
    assert code not in found.url
    assert (status, list(told)) == (403, ["error"])


def test_a_visitor_has_the_view_and_only_the_stop_button(browser: Any, served: Bench) -> None:
    """The visitor's page has no experiment, no arming, no recordings, no reset."""
    pytest.importorskip("cryptography", reason="no cryptography: no certificate for visitors")
    with (
        dashboard(DashboardSettings(connect=served.endpoint, share="127.0.0.1")) as found,
        opened(browser, found.shared_url, PHONE, ignore_https_errors=True) as page,
    ):
        seen = [b for b in page.locator("button").all() if b.is_visible()]
        names = " ".join(b.text_content() for b in seen)
        assert names == (
            "Stop Space Live L Theme: system 5 s 30 s 5 min Time: from now PNG SVG CSV"
        )


def test_the_page_shows_a_killed_daemon_as_stale_until_it_restarts(
    browser: Any, bench: Bench
) -> None:
    bench.configure(watchdog_ms=250)
    bench.emulate()
    daemon = bench.serve()
    with watched(bench) as client, opened(browser, client.url) as page:
        daemon.kill()
        daemon.popen.wait(10)
        page.wait_for_selector(".pill.stale")
        until(page, lambda: "armrig lab" in text(page, "#stale-why"))  # no sample comes any more
        # The last that the server knows: a machine that stalls may have made it another than safe.
        last = client.first("status")["phase"]
        assert f"the last phase was {last}." in text(page, "#stale-what")
        assert text(page, "#phase") == "no data"
        assert page.title().startswith("no data")
        assert not page.is_enabled("#arm")
        until(page, lambda: text(page, "#value-u").startswith("last: "))
        assert (
            page.evaluate("getComputedStyle(document.querySelector('.value')).fontWeight") == "400"
        )
        bench.serve()
        page.wait_for_selector(".pill.safe")
        assert not page.is_visible("#stale")


def test_the_page_outlives_a_frozen_daemon(browser: Any, bench: Bench) -> None:
    bench.emulate()
    pid = bench.serve().popen.pid
    with watched(bench) as client, opened(browser, client.url) as page:
        freeze(pid)
        until(page, lambda: f"kill -9 {pid} ends it" in text(page, "#stale-why"))
        assert text(page, "#phase") == "no data"
        os.kill(pid, signal.SIGCONT)
        page.wait_for_selector("#stale", state="hidden")


def test_each_limit_in_force_is_a_red_line_in_the_plot_of_its_channel(
    browser: Any, bench: Bench
) -> None:
    bench.configure(more="[limits]\nrevolutions = 3\nalpha_rad = 0.5\nu_max_v = 4.5")
    bench.emulate()
    bench.serve()
    with watched(bench) as client, opened(browser, client.url, color_scheme="light") as page:
        until(page, lambda: text(page, "#value-theta_1_turned") == "no run")
        until(page, lambda: page.evaluate(_CHARTS_WITH_RED) == [0, 2, 4])  # u, turns, alpha


def test_an_undelivered_stop_shows_its_remedy_until_it_is_confirmed(
    browser: Any, client: Client, served: Bench
) -> None:
    with watched(served) as short:
        context = opened(browser, short.url)
        page = context.__enter__()
    page.wait_for_selector(".pill.stale")
    until(page, lambda: re.search("armrig dashboard|silent", text(page, "#stale-why")))
    page.clock.install()
    page.keyboard.press("Space")
    page.wait_for_selector("#undelivered[role=alert]")
    first, *_, last = page.locator("#undelivered p").all_text_contents()
    assert "pull the plug" in first
    assert "armrig stop" in last
    page.clock.fast_forward(60_000)
    assert page.is_visible("#undelivered")
    page.click("#undelivered-seen")
    assert not page.is_visible("#undelivered")
    context.__exit__(None, None, None)


def test_an_unplugged_device_is_a_fault_that_is_reset(browser: Any, bench: Bench) -> None:
    bench.configure(watchdog_ms=250)
    emulator = bench.emulate()
    bench.serve()
    with watched(bench) as client, opened(browser, client.url) as page:
        run_step(page, bench)
        emulator.kill()
        emulator.popen.wait(10)
        page.wait_for_selector("#fault:not([hidden])")
        until(page, lambda: "ended early" in text(page, "#running-text"))
        client.wait("status", lambda seen: seen["line"])
        assert not page.is_visible("#stale")  # the fault is the one message
        assert text(page, "#fault-reason")
        assert "emulator" in text(page, "#fault-remedy")
        page.set_viewport_size(WIDE)
        page.click("#projector")
        assert page.evaluate(_FONT_PIXELS, "fault-reason") >= 24
        until(page, lambda: page.evaluate(_OVERLAPPING_PARTS) == [])
        page.click("#projector")
        assert not re.search("cable|supply", page.inner_text("body"))  # an emulator has none
        bench.emulate()
        client.wait("status", lambda seen: not seen["line"])
        page.click("#reset")
        page.wait_for_selector(".pill.safe")
        assert not page.is_visible("#fault")
