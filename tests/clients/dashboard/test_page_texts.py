"""The story of page_story.txt: the page's own scripts run in node, on a browser of stubs."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import armrig.dashboard

from tests.clients.said import compare
from tests.tools import needs

NODE = shutil.which("node")
pytestmark = needs("node")
PAGE = Path(armrig.dashboard.__file__).parent / "page"
HERE = Path(__file__).parent


def test_the_page_shows_the_stored_texts(tmp_path: Path) -> None:
    (tmp_path / "package.json").write_text('{"type": "module"}')
    for script in (*PAGE.glob("*.js"), HERE / "page_stage.js"):
        shutil.copy(script, tmp_path)
    story = (HERE / "page_story.txt").read_text(encoding="utf-8")
    script = "".join(f"{x}\n" for x in story.splitlines() if x.startswith(("> ", "#")))

    done = subprocess.run(
        [str(NODE), str(tmp_path / "page_stage.js")],
        input=script,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )

    assert done.returncode == 0, done.stderr
    compare(HERE / "page_story.txt", done.stdout)
