"""Pictures of every state of the dashboard's page, to be looked at.

`python -m tests.benchmarks.screenshots FOLDER [STATE ...]` writes one PNG for each state, width and
theme. Pages 600 px wide or narrower are those of a touch screen.
"""

from __future__ import annotations

import shutil
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import armrig
from armrig.dashboard.serving import Settings, dashboard
from playwright.sync_api import sync_playwright

from tests.clients import made_recordings
from tests.integration.driving import bring_to_rest
from tests.integration.processes import Bench, freeze
from tests.integration.watching import STEP, Client, begin, endpoint, watched

HEIGHTS = {1440: 900, 1024: 700, 390: 844, 320: 640}
TOUCH = 600
THEMES: dict[str, dict[str, Any]] = {
    "light": {"color_scheme": "light", "forced_colors": "none"},
    "dark": {"color_scheme": "dark", "forced_colors": "none"},
    "forced": {"color_scheme": "dark", "forced_colors": "active"},
}
PAUSE_MS = 600
HISTORY_MS = 6_000


def rest(page: Any) -> None:
    """Show a rig at rest."""


def preview(page: Any) -> None:
    """Show an experiment before it runs."""
    page.select_option("#kind", "step")
    page.click("#show")
    page.wait_for_selector("#preview:not([hidden])")


def refusal(page: Any) -> None:
    """Show that a field is refused."""
    page.select_option("#kind", "step")
    page.fill("#field-at", "99")
    page.click("#show")
    page.wait_for_selector("#notice:not([hidden])")


def projector(page: Any) -> None:
    """Show plots, phase and stop alone; a phone has no such button."""
    if page.is_visible("#projector"):
        page.click("#projector")


def zoom(page: Any) -> None:
    """Hold a part of the past."""
    page.focus("#plots")
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("+")


def recordings(page: Any) -> None:
    """List the recordings."""
    page.click("#tab-recordings")
    page.wait_for_selector("#table tbody button")


def recording(page: Any) -> None:
    """Show one recording."""
    recordings(page)
    page.click("#table tbody button >> nth=0")
    page.wait_for_selector("#curves canvas")
    page.locator("#one").scroll_into_view_if_needed()


def comparing(page: Any) -> None:
    """Show two recordings together."""
    recording(page)
    page.select_option("#compared", index=1)
    page.wait_for_selector("#legend .dashed")


def model(page: Any) -> None:
    """Show a model of a recording, and its simulation over the curves."""
    recording(page)
    page.click("text=Identify")
    page.wait_for_selector("#model h2")
    page.wait_for_selector(".figures img")
    page.locator("#model").scroll_into_view_if_needed()


def undelivered(page: Any) -> None:
    """Show what to do after a stop that was not delivered."""
    page.route("**/api/stop", lambda route: route.abort())
    page.keyboard.press("Space")
    page.wait_for_selector("#undelivered[role=alert]")


AT_REST = (
    *(rest, preview, refusal, projector, zoom, recordings, recording, comparing, model),
    undelivered,
)
DRIVEN = ("running", "stopped", "frozen", "fault", "stale")


class Pictures:
    """The browser, and where its pictures go."""

    def __init__(self, browser: Any, folder: Path) -> None:
        """Write into `folder`."""
        self._browser, self._folder = browser, folder
        folder.mkdir(parents=True, exist_ok=True)

    def take(self, state: str, url: str, show: Callable[[Any], None] = rest) -> None:
        """Bring the page into a state; take a picture in each width and theme."""
        for is_touch in (False, True):
            with self._page(url, is_touch=is_touch) as page:
                show(page)
                for width in (w for w in HEIGHTS if (w <= TOUCH) == is_touch):
                    page.set_viewport_size({"width": width, "height": HEIGHTS[width]})
                    for theme, media in THEMES.items():
                        page.emulate_media(**media)
                        page.wait_for_timeout(PAUSE_MS)
                        name = f"{state}-{width}-{theme}.png"
                        page.screenshot(path=self._folder / name)
        print(state, flush=True)

    @contextmanager
    def _page(self, url: str, *, is_touch: bool) -> Iterator[Any]:
        width = 390 if is_touch else 1440
        size = {"width": width, "height": HEIGHTS[width]}
        how = {"viewport": size, "has_touch": is_touch, "ignore_https_errors": True}
        page = self._browser.new_page(**how)
        page.goto(url)
        page.wait_for_selector(".pill:not(:has-text('connecting'))")
        page.wait_for_timeout(PAUSE_MS)
        yield page
        page.close()


def _fill(bench: Bench) -> None:
    """Put recordings into the folder."""
    for seed, name in enumerate(("monday", "tuesday", "x" * 60)):
        u = armrig.telegraph(1500, 0.05, seed=seed)
        (bench.recordings / f"{name}.mcap").write_bytes(made_recordings.of_the_arm(u))


def _driven(bench: Bench, client: Client, pictures: Pictures, wanted: set[str]) -> None:
    """Take the pictures of a rig that moves, and of a rig without its line or daemon."""
    emulator, daemon = bench.processes[:2]

    def take(state: str) -> None:
        if state in wanted:
            pictures.take(state, client.url)

    begin(client, bench, STEP)
    take("running")
    client.ask("/api/stop", {"owner": "Ada"})
    client.wait("run", lambda seen: not seen["is_going"])
    take("stopped")
    bring_to_rest(bench)
    begin(client, bench, STEP)
    freeze(emulator.popen.pid)
    client.wait("status", lambda seen: seen["line"])
    take("frozen")
    emulator.kill(signal.SIGCONT)
    client.wait("status", lambda seen: not seen["line"])
    bring_to_rest(bench)
    begin(client, bench, STEP)
    emulator.kill()
    emulator.popen.wait(10)
    client.wait("status", lambda seen: seen["line"])
    take("fault")
    daemon.kill()
    daemon.popen.wait(10)
    client.wait("live", lambda seen: seen["is_stale"])
    take("stale")


def main() -> None:
    """Take the pictures of the states that are named, or of all."""
    folder, *states = sys.argv[1:]
    known = [show.__name__ for show in AT_REST] + ["visitor", *DRIVEN]
    wanted = set(states or known)
    with tempfile.TemporaryDirectory() as temporary, sync_playwright() as started:
        bench = Bench(Path(temporary))
        bench.configure(watchdog_ms=250)
        browser = started.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        pictures = Pictures(browser, Path(folder))
        try:
            bench.emulate()
            bench.serve()
            bench.recordings.mkdir(exist_ok=True)
            _fill(bench)
            with watched(bench) as client:
                client.wait("live", lambda seen: not seen["is_stale"])
                for show in AT_REST:
                    if show.__name__ in wanted:
                        pictures.take(show.__name__, client.url, show)
                if "visitor" in wanted:
                    shared = Settings(connect=endpoint(bench), share="127.0.0.1")
                    with dashboard(shared) as found:
                        pictures.take("visitor", str(found.shared_url))
                if wanted & {*DRIVEN}:
                    _driven(bench, client, pictures, wanted)
        finally:
            browser.close()
            bench.end()


if __name__ == "__main__":
    main()
