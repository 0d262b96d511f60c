"""README's first screen, line by line, on an empty Debian without a compiler (`make walk`)."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.systemd import empty_debian
from tests.systemd.machine import CHECKOUT, missing

pytestmark = pytest.mark.machine

README = (CHECKOUT / "README.md").read_text(encoding="utf-8").partition("## Your own")[0]
README = README.partition("## Install for daily use")[2]
LINES: str = re.findall(r"```\n(.*?)```", README, re.DOTALL)[0]
DEMO = LINES.splitlines()[-1]
WITH_PIPX = "pipx install ."


@pytest.mark.parametrize(
    ("packages", "lines"),
    [(("python3", "python3-venv"), LINES), (("pipx",), f"{WITH_PIPX}\n. ~/.profile\n{DEMO}")],
    ids=["venv", "pipx"],
)
def test_the_demo_of_the_readme_runs_on_an_empty_debian(
    packages: tuple[str, ...], lines: str, tmp_path: Path
) -> None:
    if why := missing() or empty_debian.missing():
        pytest.skip(why)
    assert {f"`{name}`" in README for name in (*packages, WITH_PIPX)} == {True}
    root = tmp_path / "root"
    empty_debian.make(root, "ca-certificates", *packages)
    empty_debian.lay_checkout(root / "home/alice/armrig")

    empty_debian.type_in(
        root,
        f"""
        update-ca-certificates >/dev/null
        useradd --shell /bin/bash alice
        cp /etc/skel/.profile /home/alice
        chown -R alice: /home/alice
        su - alice -c 'set -e; cd armrig; {"; ".join(lines.splitlines())}'
        """,
    )

    assert not (root / "usr/bin/cc").exists()
    report = root / "home/alice/armrig/demo/report.pdf"
    assert report.read_bytes().startswith(b"%PDF-")
