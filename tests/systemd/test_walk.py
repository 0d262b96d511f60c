"""docs/service.md and docs/access.md, line by line: from nothing to a recording over the network.

On a machine of its own, with a network namespace of that as an operator's. Left out is what fetches
packages; the checkout is installed already. It takes a minute or so.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from machine import CHECKOUT, Machine, missing, wait_for

SERVICE, ACCESS = (
    (CHECKOUT / "docs" / f"{page}.md").read_text(encoding="utf-8") for page in ("service", "access")
)
HOST, RIG, LAPTOP = "lab-1.example.edu", "192.0.2.10", "192.0.2.20"


def _blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page, re.DOTALL)


FETCH, BOARDS, EMULATE, ENABLE, JOIN, COLLECT = _blocks(SERVICE, "sh")
(CONFIGURATION,) = _blocks(SERVICE, "toml")
_, MAKE, PUT, RESTART, KEEP, USE, CHANGE = _blocks(ACCESS, "sh")
LISTEN, CONNECT, *_ = _blocks(ACCESS, "toml")
(DROP_IN,) = _blocks(ACCESS, "ini")


class Lab:
    """The rig's machine, its users, and beside it the network of an operator's."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        for user in ("student", "alice"):
            machine.run("useradd", "--create-home", "--home-dir", f"/srv/{user}", user)
        self.script(
            f"""
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

    def script(self, text: str) -> str:
        """Type lines as root; return what they print."""
        return self._typed(text, user="", folder="/root")

    def student(self, text: str) -> str:
        """Type lines as a student at the rig's machine."""
        return self._typed(text, user="student", folder="/srv/student")

    def alice(self, text: str) -> str:
        """Type lines as an operator at her own machine, which sees no socket of the rig's."""
        hidden = "mount -t tmpfs none /run/armrig; exec setpriv --reuid=alice --regid=alice"
        inner = f"cd /srv/alice; HOME=/srv/alice; export HOME; set -e\n{text}"
        return self.machine.run(
            *("nsenter", "--net=/run/netns/laptop", "unshare", "--mount"),
            *("sh", "-c", f'{hidden} --init-groups sh -c "$1"', "sh", inner),
        ).stdout

    def _typed(self, text: str, *, user: str, folder: str) -> str:
        command = f"cd {folder}; HOME={folder}; export HOME; set -e\n{text}"
        return self.machine.run("sh", "-c", command, user=user).stdout


@pytest.fixture(scope="module")
def lab() -> Iterator[Lab]:
    """Give a machine on which nothing is installed but the program."""
    if why := missing():
        pytest.skip(why)
    machine = Machine()
    try:
        made = machine.run("ip", "link", "add", "trial", "type", "veth", check=False)
        if made.returncode != 0:
            pytest.skip(f"no interface can be made here: {made.stderr.strip()}")
        machine.run("ip", "link", "delete", "trial")
        yield Lab(machine)
    finally:
        machine.end()


def _serves(lab: Lab) -> bool:
    status = lab.machine.shown("armrigd@1.service", "StatusText")["StatusText"]
    return status == "safe, nobody has it"


def test_from_nothing_to_a_recording_over_the_network(lab: Lab) -> None:
    """Each line of both pages that a lab engineer types, in their order."""
    machine = lab.machine
    *fetched, last = FETCH.splitlines()
    assert [line.split()[0] for line in fetched] == [
        "apt",
        "python3",
        "/opt/armrig/bin/pip",
        "ln",
    ]

    # The service, with an emulated rig in place of a board.
    lab.script(f"{last} --yes")
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
    lab.script("cp /srv/alice/pki/rig-1.pem /srv/alice/pki/access.toml .\n" + PUT)
    machine.write(Path("/etc/armrig/1.toml"), port + LISTEN)
    machine.write(Path("/etc/systemd/system/armrigd@1.service.d/override.conf"), DROP_IN)
    lab.script("systemctl daemon-reload")  # which `systemctl edit` does
    said = lab.script(RESTART)
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
    lab.script("cp /srv/alice/pki/rig-1.pem /srv/alice/pki/access.toml .\n" + PUT)
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
