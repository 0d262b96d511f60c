"""docs/service.md and docs/access.md, line by line: from nothing to a recording over the network.

On an empty Debian (`make walk`, minutes): every line. On a machine with this host's files, where
the program is there already: without the lines that fetch packages. A network namespace of the
machine is an operator's, with the same files.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import empty_debian
import pytest
from machine import CHECKOUT, Machine, missing, wait_for

pytestmark = pytest.mark.machine

SERVICE, ACCESS = (
    (CHECKOUT / "docs" / f"{page}.md").read_text(encoding="utf-8") for page in ("service", "access")
)
AT_LAPTOP = ("nsenter", "--net=/run/netns/laptop", "unshare", "--mount")
ALICE = "--reuid=alice --regid=alice --init-groups"
HOST, RIG, LAPTOP = "lab-1.example.edu", "192.0.2.10", "192.0.2.20"


def _blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page, re.DOTALL)


FETCH, BOARDS, EMULATE, ENABLE, JOIN, COLLECT = _blocks(SERVICE, "sh")
*FETCHED, INSTALL = FETCH.splitlines()
(CONFIGURATION,) = _blocks(SERVICE, "toml")
WITH_PKI, MAKE, PUT, RESTART, KEEP, USE, CHANGE, *_ = _blocks(ACCESS, "sh")
LISTEN, CONNECT, *_ = _blocks(ACCESS, "toml")
(DROP_IN,) = _blocks(ACCESS, "ini")


class Lab:
    """The rig's machine, its users, and beside it the network of an operator's."""

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
            echo {RIG} {HOST} >> /etc/hosts
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


def _serves(lab: Lab) -> bool:
    status = lab.machine.shown("armrigd@1.service", "StatusText")["StatusText"]
    return status == "safe, nobody has it"


def test_from_nothing_to_a_recording_over_the_network(lab: Lab) -> None:
    """Each line of both pages that a lab engineer types, in their order."""
    machine = lab.machine

    # The service, with an emulated rig in place of a board.
    lab.script(f"{INSTALL} --yes")
    assert BOARDS == "ls /dev/armrig-*\n"
    lab.script(EMULATE)
    wait_for(machine.path("/run/rig-1/tty").is_symlink)
    port = CONFIGURATION.replace("/dev/armrig-55639303535351F0E1B1", "/run/rig-1/tty")
    port = port.replace("[limits]", "watchdog_ms = 250\n[limits]")
    machine.write(Path("/etc/armrig/1.toml"), port)
    lab.script(ENABLE)
    wait_for(lambda: _serves(lab))
    lab.script(JOIN)
    _until_it_works(lab.student, COLLECT)
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
    *_, recording = _until_it_works(lab.alice, USE).splitlines()

    owner = lab.student(f"armrig info {recording} | grep ^owner")
    assert owner.endswith("(certificate alice)\n")
    assert lab.alice("armrig record --seconds 1 -o copy.mcap && armrig info copy.mcap")


def test_the_network_is_open_to_the_lab_alone_and_costs_what_the_page_says(lab: Lab) -> None:
    """By the kernel's filter, where systemd can set it; the score is that of `systemd-analyze`."""
    machine = lab.machine
    judged = lab.script("systemd-analyze security --no-pager armrigd@1 || true")
    (score,) = re.findall(r"Overall exposure level for \S+: ([0-9.]+)", judged)

    assert f"`systemd-analyze security armrigd@1` is then {score} instead of" in ACCESS
    families = machine.shown("armrigd@1.service", "RestrictAddressFamilies")
    assert set(families["RestrictAddressFamilies"].split()) == {"AF_INET", "AF_INET6", "AF_UNIX"}
    machine.run("ip", "address", "add", "198.51.100.10/24", "dev", "lab")
    machine.run("ip", "-n", "laptop", "address", "add", "198.51.100.20/24", "dev", "laptop")
    journal = machine.run("journalctl", "--no-pager", "-u", "armrigd@1").stdout
    if "firewall" in journal:
        pytest.skip("systemd can set no filter of addresses here")
    outside = "tls/198.51.100.10:7447"
    assert "no firewall stands between" in _refused(lab, f"armrig status --connect {outside}")


def test_who_is_revoked_is_out_after_a_reload(lab: Lab) -> None:
    """As the page says: his name is given to nobody again, and the list is read anew."""
    lab.alice(CHANGE)
    lab.script("cp /home/alice/pki/rig-1.pem /home/alice/pki/access.toml .\n" + PUT)
    lab.alice("armrig status")

    pid = lab.machine.shown("armrigd@1.service", "MainPID")["MainPID"]
    lab.script("systemctl reload armrigd@1")
    wait_for(lambda: lab.machine.shown("armrigd@1.service", "MainPID")["MainPID"] not in ("0", pid))
    wait_for(lambda: _serves(lab))

    assert "not permitted" in _refused(lab, "armrig status")
    lab.alice("ARMRIG_CLIENT_CERTIFICATE=pki/alice-2.pem armrig stop")


def _refused(lab: Lab, command: str) -> str:
    """Return what a command of alice's is refused with."""
    return lab.alice(f"{command} 2>&1 && exit 1 || true")


def _until_it_works(typed: Callable[[str], str], text: str) -> str:
    """Type lines, again where a machine that stalls has ended a run."""
    for _ in range(2):
        try:
            return typed(text)
        except AssertionError as err:
            if "the host paused" not in str(err) and "WATCHDOG" not in str(err):
                raise
    return typed(text)
