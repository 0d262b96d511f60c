"""docs/access.md: its packet filter keeps a stranger's connections out of the others' way."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.integration import namespaces
from tests.integration.laboratory import by_certificate, certificates
from tests.integration.namespaces import Namespaces
from tests.integration.processes import Bench
from tests.integration.remote_rig import GUARDED, PORT, started, stranger
from tests.tools import require

pytestmark = pytest.mark.machine
PAGE = (Path(__file__).parents[2] / "docs" / "access.md").read_text(encoding="utf-8")
(RULES,) = re.findall(r"```nft\n(.*?)```", PAGE, re.DOTALL)
ELSEWHERE = "10.77.0.4"
TRIED, SECONDS = 100, 20
HELD = 16
"""Connections of one address at a time, as on the page."""
HOLDER = f"""
import select, socket, time
poll, held = select.poll(), []
for _ in range({TRIED}):
    one = socket.socket()
    one.setblocking(False)
    one.bind(("{ELSEWHERE}", 0))
    one.connect_ex(("{namespaces.ADDRESSES["rig"]}", {PORT}))
    held.append(one)
    time.sleep({SECONDS / TRIED})
print(sum(bool(select.select([], [one], [], 0)[1]) for one in held), flush=True)
input()
"""


@pytest.fixture
def line() -> Iterator[Namespaces]:
    """Give two machines, the strangers' with a second address."""
    if why := namespaces.missing():
        pytest.skip(why)
    require("nft")
    with namespaces.connected() as both:
        address = ("ip", "address", "add", f"{ELSEWHERE}/24", "dev", "line")
        _run(both.command("stranger", *address))
        yield both


def _run(command: list[str], text: str = "") -> str:
    done = subprocess.run(command, input=text, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@contextmanager
def _held(line: Namespaces) -> Iterator[int]:
    """Have a client hold as many connections as possible; give their number."""
    command = line.command("stranger", sys.executable, "-c", HOLDER)
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as holder:
        assert holder.stdout is not None
        yield int(holder.stdout.readline())
        holder.communicate("\n")


def test_the_packet_filter_limits_the_connections_of_an_unknown_host(
    line: Namespaces, bench: Bench
) -> None:
    made = certificates(bench.folder)
    where = by_certificate(bench, made, f"tls/{namespaces.ADDRESSES['rig']}:{PORT}")
    bench.emulate()
    with started(line, bench, *GUARDED):
        with _held(line) as without:
            pass
        _run(line.command("rig", "nft", "-f", "-"), RULES)
        with _held(line) as held:
            watcher = stranger(line, where, made, "watch", "carol.pem")
            assert watcher.stdout is not None
            assert watcher.stdout.readline() == "there\n"
            watcher.communicate()

    assert without == TRIED
    assert 0 < held <= HELD
