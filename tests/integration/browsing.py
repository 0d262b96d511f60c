"""A browser, in which a test sees the dashboard as a person does."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from tests.integration.processes import WITHIN_S

CHROMIUM = shutil.which("chromium")
WIDE, PHONE = {"width": 1280, "height": 900}, {"width": 390, "height": 844}
SMALL = {"width": 640, "height": 480}  # to draw it costs a third
KEEP_NOTICES = """
window.notices = [];
document.addEventListener("DOMContentLoaded", () => {
  const shown = document.querySelector("#notice");
  const keep = () => window.notices.push(shown.textContent);
  new MutationObserver(keep).observe(shown, {childList: true, characterData: true, subtree: true});
});
"""
PATIENCE_MS = 1000 * WITHIN_S


@contextmanager
def opened(browser: Any, url: str, size: dict[str, int] = SMALL, **how: Any) -> Iterator[Any]:
    """Give a page that shows a rig that is not stale; in its console there must be no error."""
    page = browser.new_page(viewport=size, **how)
    page.set_default_timeout(PATIENCE_MS)
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("console", lambda told: errors.append(told.text) if told.type == "error" else None)
    page.add_init_script(KEEP_NOTICES)
    try:
        page.goto(url)
        page.wait_for_selector(".pill.safe")
        yield page
        # The browser itself reports a server that is gone.
        assert [text for text in errors if "Failed to load resource" not in text] == []
    finally:
        page.close()


def until(page: Any, what: Callable[[], object], within_s: float = WITHIN_S) -> None:
    """Wait until `what` is true; the page's policy forbids a script of the browser's driver."""
    last_s = time.monotonic() + within_s
    while not what():
        assert time.monotonic() < last_s, "it did not happen in time"
        page.wait_for_timeout(100)


def text(page: Any, selector: str) -> str:
    """Return the text of an element."""
    return str(page.text_content(selector))
