"""docs/service.md and access.md, line by line: from nothing to a lab.

On an empty Debian (`make walk`, minutes): every line. On a machine with this host's files, where
the program is there already: without the lines that fetch packages. A network namespace of the
machine is an operator's, with the same files.
"""

from __future__ import annotations

import os
import re
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.stalls.host import Host
from tests.stalls.repeats import MAX_REPEATS, STALL_NS
from tests.systemd import empty_debian
from tests.systemd.machine import CHECKOUT, Machine, missing, wait_for

pytestmark = pytest.mark.machine

SERVICE, ACCESS = (
    (CHECKOUT / "docs" / f"{page}.md").read_text(encoding="utf-8") for page in ("service", "access")
)
AT_LAPTOP = ("nsenter", "--net=/run/netns/laptop", "unshare", "--mount")
ALICE = "--reuid=alice --regid=alice --init-groups"
AS_ALICE_2 = "export ARMRIG_CLIENT_CERTIFICATE=pki/alice-2.pem\n"
HOST, ROUTER_HOST = "lab-1.example.edu", "lab.example.edu"
RIG, LAPTOP = "192.0.2.10", "192.0.2.20"
BY_ID = "/dev/armrig-55639303535351F0E1B1"


def _blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page, re.DOTALL)


FETCH, BOARDS, EMULATE, CHECK, ENABLE, JOIN, COLLECT, NAME_RECORDER, RECORD = _blocks(SERVICE, "sh")
*FETCHED, INSTALL = FETCH.splitlines()
CONFIGURATION, *_ = _blocks(SERVICE, "toml")
(KEEP_90_DAYS,) = _blocks(SERVICE, "text")
WITH_PKI, MAKE, PUT, RESTART, KEEP, USE, CHANGE, MAKE_ROUTER, ROUTE, _, LOOK = _blocks(ACCESS, "sh")
LISTEN, CONNECT, *_, AT_ROUTER = _blocks(ACCESS, "toml")
(DROP_IN,) = _blocks(ACCESS, "ini")


class Lab:
    """The rig's machine, its users, and an operator's network."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        self.script(
            f"""
            adduser --quiet --disabled-password --gecos '' student
            adduser --quiet --disabled-password --gecos '' alice
            ip netns add laptop
            ip link add lab type veth peer name laptop netns laptop
            ip address add {RIG}/24 dev lab
            ip link set lab up
            ip -n laptop address add {LAPTOP}/24 dev laptop
            ip -n laptop link set laptop up
            ip -n laptop link set lo up
            echo {RIG} {HOST} {ROUTER_HOST} >> /etc/hosts
            """
        )

    def script(self, text: str, *, online: bool = False) -> str:
        """Type lines as root; return what they print."""
        command = f"cd /root; HOME=/root; export HOME; set -e\n{text}"
        return self.machine.run("sh", "-c", command, online=online).stdout

    def student(self, text: str) -> str:
        """Type lines as a student at the rig's machine."""
        return self.machine.run("sh", "-c", _at_home("student", text), user="student").stdout

    def alice(self, text: str) -> str:
        """Type lines as an operator at her own machine, which sees no socket of the rig's."""
        hidden = "test ! -d /run/armrig || mount -t tmpfs none /run/armrig; exec setpriv "
        shell = ("sh", "-c", f'{hidden} {ALICE} sh -c "$1"', "sh", _at_home("alice", text))
        return self.machine.run(*AT_LAPTOP, *shell).stdout

    def said(self, unit: str) -> str:
        """Return the journal of a unit, systemd's own lines included."""
        return self.script(f"journalctl --sync; journalctl --no-pager -u {unit}")


def _at_home(user: str, text: str) -> str:
    return f"cd /home/{user}; HOME=/home/{user}; export HOME; set -e\n{text}"


@contextmanager
def _with_this_host_s_files() -> Iterator[Lab]:
    """Give a machine on which nothing is installed but the program."""
    machine = Machine()
    try:
        yield Lab(machine)
    finally:
        machine.end()


@contextmanager
def _empty() -> Iterator[Lab]:
    """Give an empty Debian on which all that the pages fetch was fetched, as they say it."""
    if why := empty_debian.missing():
        pytest.skip(why)
    with tempfile.TemporaryDirectory(prefix="armrig-debian-") as folder:
        root = Path(folder) / "root"
        empty_debian.make(root, "iproute2")  # with which the test lays its network
        apt, *others = FETCHED
        empty_debian.type_in(root, apt.replace("apt install", "apt install --yes"))
        empty_debian.lay_checkout(root / "root" / "armrig")
        machine = Machine(root)
        try:
            lab = Lab(machine)
            # Alice's machine has the same files, and so the same program, with her package.
            lines = ["cd armrig", *others, f"/opt/armrig/bin/{WITH_PKI}"]
            lab.script("\n".join(lines), online=True)
            yield lab
        finally:
            machine.end()


@pytest.fixture(scope="module", params=[_with_this_host_s_files, _empty])
def lab(request: pytest.FixtureRequest) -> Iterator[Lab]:
    """Give a laboratory where `armrig` can be called and no service is."""
    if why := missing():
        pytest.skip(why)
    with request.param() as lab:
        yield lab


def _serves(lab: Lab, rig: str = "1") -> bool:
    status = lab.machine.shown(f"armrigd@{rig}.service", "StatusText")["StatusText"]
    return status == "safe, nobody has it"


def _with_yes(text: str) -> str:
    """Return lines that need no answer of a person."""
    return re.sub(r"(?m)^(armrig service install.*)$", r"\1 --yes", text)


def test_the_pages_lead_from_the_installation_to_a_network_recording(lab: Lab) -> None:
    machine = lab.machine

    # The service, with an emulated rig in place of a board.
    lab.script(f"{INSTALL} --yes")
    assert BOARDS == "ls /dev/armrig-*\n"
    lab.script(EMULATE)
    wait_for(machine.path("/run/rig-1/tty").is_symlink)
    port = _configuration("1")
    machine.write(Path("/etc/armrig/1.toml"), port.replace("u_max_v = 4.5", "u_max_v = 45"))
    assert "u_max_v = 45: expected `float` <= 5" in _fails(lab.script, CHECK, 78)
    machine.write(Path("/etc/armrig/1.toml"), port)
    checked = "/etc/armrig/1.toml: rig 1, port /run/rig-1/tty at 500000 baud, 0 to 4.5 V\n"
    assert lab.script(CHECK) == checked
    lab.script(ENABLE)
    wait_for(lambda: _serves(lab))
    lab.script(JOIN)
    _again_after_a_stall(lab.student, COLLECT)
    assert "owner" in lab.student("armrig info @first")

    # The authority, on the operator's machine; its files, on the rig's.
    lab.alice(MAKE)
    lab.script("cp /home/alice/pki/rig-1.pem /home/alice/pki/access.toml .\n" + PUT)
    machine.write(Path("/etc/armrig/1.toml"), port + LISTEN)
    machine.write(Path("/etc/systemd/system/armrigd@1.service.d/override.conf"), DROP_IN)
    lab.script("systemctl daemon-reload")  # which `systemctl edit` does
    said = lab.script(RESTART)
    assert (
        lab.student("cat /etc/armrig/rig-1.pem 2>/dev/null || cat /etc/armrig/access.toml")[0]
        == "#"
    )
    assert "also at tls/0.0.0.0:7447: 1 may drive and 1 may watch" in said

    lab.alice("cp pki/alice.pem .\n" + KEEP + f"cat > .config/armrig/armrig.toml <<'E'\n{CONNECT}E")
    *_, recording = _again_after_a_stall(lab.alice, USE).splitlines()

    owner = lab.student(f"armrig info {recording} | grep ^owner")
    assert owner.endswith("(certificate alice)\n")
    assert lab.alice("armrig record --seconds 1 -o copy.mcap && armrig info copy.mcap")


def test_a_revoked_client_is_refused_after_a_reload(lab: Lab) -> None:
    lab.alice(CHANGE)
    lab.script("cp /home/alice/pki/rig-1.pem /home/alice/pki/access.toml .\n" + PUT)
    lab.alice("armrig status")

    pid = lab.machine.shown("armrigd@1.service", "MainPID")["MainPID"]
    lab.script("systemctl reload armrigd@1")
    wait_for(lambda: lab.machine.shown("armrigd@1.service", "MainPID")["MainPID"] not in ("0", pid))
    wait_for(lambda: _serves(lab))

    assert "not permitted" in _refused(lab, "armrig status")
    lab.alice("ARMRIG_CLIENT_CERTIFICATE=pki/alice-2.pem armrig stop")


def test_a_second_rig_is_reached_through_the_lab_s_router(lab: Lab) -> None:
    machine = lab.machine
    lab.script("systemctl stop armrigd@1")  # which has the router's port here
    lab.alice(MAKE_ROUTER)
    lab.script("cp /home/alice/pki/router.pem /home/alice/pki/access.toml .")
    install, *put = _with_yes(ROUTE).splitlines()
    lab.script(install)
    lab.script("chmod 600 /etc/armrig/access.toml")
    lab.script("systemctl start armrig-router")
    unreadable = "path '/etc/armrig/access.toml' is not readable"
    wait_for(lambda: unreadable in lab.said("armrig-router"))
    wait_for(lambda: machine.shown("armrig-router", "ActiveState")["ActiveState"] == "failed")

    lab.script("\n".join(put))

    wait_for(lambda: "router at tls/0.0.0.0:7447" in lab.said("armrig-router"))
    assert "0.0.0.0:7447: 2 rigs, 1 may drive and 1 may watch" in lab.said("armrig-router")
    put_key = PUT.splitlines()[0].replace("rig-1.pem", "rig-2.pem")
    lab.script("cp /home/alice/pki/rig-2.pem .\n" + put_key)
    lab.script(EMULATE.replace("rig-1", "rig-2"))
    wait_for(machine.path("/run/rig-2/tty").is_symlink)
    machine.write(Path("/etc/armrig/2.toml"), _configuration("2") + AT_ROUTER)
    machine.write(Path("/etc/systemd/system/armrigd@2.service.d/override.conf"), DROP_IN)
    lab.script("systemctl daemon-reload\n" + "systemctl enable --now armrigd@2")
    assert "systemctl enable --now armrigd@2" in SERVICE
    wait_for(lambda: "connected to the router" in lab.said("armrigd@2"))
    looked = lab.alice(AS_ALICE_2 + LOOK)
    assert "safe" in looked


def test_a_recorder_records_all_rigs_and_recovers_files_of_a_killed_one(lab: Lab) -> None:
    lab.alice(NAME_RECORDER)
    lab.script("cp /home/alice/pki/recorder.pem /home/alice/pki/access.toml .")
    lab.script("\n".join(line for line in ROUTE.splitlines() if "access.toml" in line))
    lab.script("systemctl restart armrig-router")
    lab.script(_with_yes(RECORD))
    wait_for(lambda: "recording rig 2" in lab.said("armrig-recorder"))
    folder = lab.machine.path("/var/lib/armrig-recorder")
    wait_for(lambda: [*folder.glob("2-remote-*.mcap.active")])

    lab.script("systemctl kill --signal=KILL armrig-recorder")

    wait_for(lambda: "recovered" in lab.said("armrig-recorder"), 60)
    wait_for(lambda: lab.said("armrig-recorder").count("recording rig 2") == 2, 60)
    lab.script("systemctl stop armrig-recorder")
    assert lab.machine.shown("armrig-recorder", "Result") == {"Result": "success"}
    assert not [*folder.glob("*.active")]
    assert len([*folder.glob("2-remote-*.mcap")]) == 2
    assert lab.student("for f in /var/lib/armrig-recorder/*.mcap; do armrig info $f; done")
    lab.machine.write(Path("/etc/tmpfiles.d/armrig-keep.conf"), KEEP_90_DAYS)
    old, *_ = folder.glob("2-remote-*.mcap")
    unfinished = folder / "2-remote-x.mcap.active"
    unfinished.touch()
    for path in (old, unfinished):
        os.utime(path, (0, 0))
    lab.script("systemctl start armrig-recorder\nsystemd-tmpfiles --clean")
    assert (old.exists(), unfinished.exists()) == (False, True)
    unfinished.unlink()


def _configuration(rig: str) -> str:
    """Return the configuration of the page, of an emulated rig."""
    text = CONFIGURATION.replace(BY_ID, f"/run/rig-{rig}/tty")
    return text.replace("[limits]", "watchdog_ms = 250\n[limits]")


def _fails(typed: Callable[[str], str], text: str, code: int) -> str:
    """Type a line that must end with an exit code; return its output."""
    return typed(f"({text.strip()}) 2>&1 && exit 99 || test $? = {code}")


def _refused(lab: Lab, command: str) -> str:
    """Return the refusal of a command of alice."""
    return _fails(lab.alice, command, 1)


def _again_after_a_stall(typed: Callable[[str], str], text: str) -> str:
    """Type lines, again if the host stalled: a stall ends the run of an emulated rig."""
    host = Host()
    try:
        for _ in range(MAX_REPEATS):
            began_ns = time.monotonic_ns()
            try:
                return typed(text)
            except AssertionError:
                if host.longest_ns(began_ns, time.monotonic_ns()) < STALL_NS:
                    raise
        return typed(text)
    finally:
        host.end()
