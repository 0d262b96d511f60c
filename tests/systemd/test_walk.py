"""docs/service.md, access.md, class.md and firmware.md, line by line: from nothing to a lab.

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

SERVICE, ACCESS, CLASS, FIRMWARE = (
    (CHECKOUT / "docs" / f"{page}.md").read_text(encoding="utf-8")
    for page in ("service", "access", "class", "firmware")
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
(NARROW,) = _blocks(SERVICE, "ini")
(KEEP_90_DAYS,) = _blocks(SERVICE, "text")
WITH_PKI, MAKE, PUT, RESTART, KEEP, USE, CHANGE, MAKE_ROUTER, ROUTE, _, LOOK = _blocks(ACCESS, "sh")
LISTEN, CONNECT, *_, AT_ROUTER = _blocks(ACCESS, "toml")
(DROP_IN,) = _blocks(ACCESS, "ini")
FOLDERS, RUN, BY_STUDENT, SECOND, *_ = _blocks(CLASS, "sh")
(LIMITS,) = _blocks(CLASS, "toml")
(IN_SIMAVR,) = _blocks(FIRMWARE, "sh")
STATUS_OF_UNO = "armrig status --connect unixsock-stream//run/of-uno/1.sock 2>&1 || :"


class Lab:
    """The rig's machine, its users, and an operator's network."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        self.script(
            f"""
            adduser --quiet --disabled-password --gecos '' student
            adduser --quiet --disabled-password --gecos '' alice
            adduser --quiet --disabled-password --gecos '' eve
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

    def student(self, text: str, user: str = "student") -> str:
        """Type lines as a student, or another user, at the rig's machine."""
        return self.machine.run("sh", "-c", _at_home(user, text), user=user).stdout

    def alice(self, text: str, user: str = "alice") -> str:
        """Type lines as an operator at her own machine, which sees no socket of the rig's."""
        hidden = "test ! -d /run/armrig || mount -t tmpfs none /run/armrig; exec setpriv "
        who = ALICE.replace("alice", user)
        shell = ("sh", "-c", f'{hidden} {who} sh -c "$1"', "sh", _at_home(user, text))
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
        # With which the test lays its network, and which docs/class.md takes to be there.
        empty_debian.make(root, "iproute2", "sudo")
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


def test_from_nothing_to_a_recording_over_the_network(lab: Lab) -> None:
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


def test_the_network_is_open_to_the_lab_alone_and_costs_what_the_page_says(lab: Lab) -> None:
    machine = lab.machine
    score = _score(lab, "armrigd@1")

    assert f"`systemd-analyze security armrigd@1` reports increases from 0.5 to {score}" in ACCESS
    families = machine.shown("armrigd@1.service", "RestrictAddressFamilies")
    assert set(families["RestrictAddressFamilies"].split()) == {"AF_INET", "AF_INET6", "AF_UNIX"}
    machine.run("ip", "address", "add", "198.51.100.10/24", "dev", "lab")
    machine.run("ip", "-n", "laptop", "address", "add", "198.51.100.20/24", "dev", "laptop")
    journal = machine.run("journalctl", "--no-pager", "-u", "armrigd@1").stdout
    if "firewall" in journal:
        pytest.skip("systemd can set no filter of addresses here")
    outside = "tls/198.51.100.10:7447"
    assert "no firewall blocks" in _refused(lab, f"armrig status --connect {outside}")


def test_a_revoked_client_is_out_after_a_reload(lab: Lab) -> None:
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


def test_a_recorder_records_all_rigs_and_what_a_kill_left_is_completed(lab: Lab) -> None:
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


def test_router_and_recorder_are_kept_to_the_lab_s_network(lab: Lab) -> None:
    units = ("armrig-router", "armrig-recorder")
    before = {_score(lab, unit) for unit in units}
    for unit in units:
        drop_in = Path(f"/etc/systemd/system/{unit}.service.d/override.conf")
        lab.machine.write(drop_in, NARROW)
    begun = lab.said("armrig-recorder").count("recording rig 2")
    lab.script("systemctl daemon-reload\nsystemctl restart " + " ".join(units))

    (score,), (after,) = before, {_score(lab, unit) for unit in units}

    assert f"is {score} for the router and for the recorder" in SERVICE
    assert f"`IPAddressAllow=` lowers (improves) the score to {after}" in SERVICE
    # The daemon comes back to a router by itself, some seconds after it.
    wait_for(lambda: "safe" in lab.alice(f"({AS_ALICE_2 + LOOK}) 2>&1 || :"))
    wait_for(lambda: lab.said("armrig-recorder").count("recording rig 2") > begun, 60)


def test_a_stranger_reaches_nothing_and_a_student_no_key(lab: Lab) -> None:
    keys = [f"/etc/armrig/{name}.pem" for name in ("router", "recorder")]
    theirs = ["/var/lib/armrig/recordings", "/var/lib/armrig-recorder"]
    for user, paths in (("student", keys), ("eve", [*keys, *theirs])):
        for path in paths:
            _fails(lambda text, user=user: lab.student(text, user), f"ls {path}/. || cat {path}", 1)
    at_rig = "armrig status --rig 2"
    assert "only the group armrig may operate rig 2" in _fails(
        lambda text: lab.student(text, "eve"), at_rig, 1
    )
    lab.alice("armrig pki ca && armrig pki operator eve", "eve")
    own = f"ARMRIG_CLIENT_CERTIFICATE=pki/eve.pem {at_rig} --connect tls/{ROUTER_HOST}:7447"
    assert "no reply from rig 2" in _fails(lambda text: lab.alice(text, "eve"), own, 1)
    said = lab.script("armrig service status")
    for service in ("rig 2: active: safe, nobody has it", "router: active", "recorder: active"):
        assert f"\n{service}, starts with the machine" in said


def test_without_the_service_a_class_has_a_daemon_of_its_own(lab: Lab) -> None:
    """docs/class.md: another user has the rig, and a group opens it."""
    if not lab.machine.path("/usr/bin/sudo").exists():
        pytest.skip("sudo is not installed")
    lab.script("armrig service uninstall --yes")
    assert lab.student("armrig service status", "eve").count("missing") == 4
    lab.script(
        """
        systemctl stop rig-1 rig-2
        rm -rf /etc/armrig/* /run/armrig
        adduser --quiet --system rig
        addgroup --quiet students
        adduser --quiet alice students
        """
        + FOLDERS
    )
    for rig in ("1", "2"):
        lab.script(EMULATE.replace("rig-1", f"class-{rig}").replace("User=armrig", "User=rig"))
        wait_for(lab.machine.path(f"/run/class-{rig}/tty").is_symlink)
    limits = LIMITS.replace("/dev/serial/by-id/usb-Arduino-if00", "/run/class-1/tty")
    limits = limits.replace("[limits]", "watchdog_ms = 250\n[limits]")
    lab.machine.write(Path("/etc/armrig/armrig.toml"), limits)
    second, asked = SECOND.splitlines()
    second = second.replace("/dev/serial/by-id/usb-Arduino-if02", "/run/class-2/tty")

    lab.script(f"systemd-run --unit=of-class-1 {RUN}\nsystemd-run --unit=of-class-2 {second}")

    status, collect, watch, stop = BY_STUDENT.splitlines()
    wait_for(lambda: "safe" in lab.student(f"{status} 2>&1 || :", "alice"))
    wait_for(lambda: "safe" in lab.student(f"{asked} 2>&1 || :", "alice"))
    assert "not permitted" in _fails(lambda text: lab.student(text, "eve"), status, 1)
    collect = collect.replace("--seconds 30", "--seconds 4")
    *_, recording = _again_after_a_stall(
        lambda text: lab.student(text, "alice"), collect
    ).splitlines()
    lab.student(f"armrig info {recording}\ntimeout 3 {watch} >&2 || test $? = 124\n{stop}", "alice")
    lab.script("systemctl stop of-class-1 of-class-2")


@pytest.mark.parametrize("lab", [_empty], indirect=True)  # the sources are there alone
def test_the_firmware_is_built_and_runs_without_a_board(lab: Lab) -> None:
    """docs/firmware.md: the same bytes as those that are committed, and every rule holds."""
    image = "firmware_protocol/firmware/armrig-uno.hex"
    packages = " ".join(sorted(set(re.findall(r"gcc-avr|avr-libc|libsimavr-dev", FIRMWARE))))
    lab.script(f"apt-get install --yes make gcc libc6-dev {packages}", online=True)
    make_fil, emulate, run, tried, alone, demo = (
        line.partition("#")[0].strip() for line in IN_SIMAVR.splitlines()
    )
    assert demo == "make demo FIRMWARE=1"  # tests/integration has it

    lab.script(f"cd armrig\ncp {image} /tmp/committed.hex\nrm {image}\nmake firmware\n{make_fil}")

    lab.script(f"cmp /tmp/committed.hex armrig/{image}")
    harness = "ARMRIG_FIL=/root/armrig/firmware_protocol/simavr/fil"
    lab.script(f"systemd-run --unit=uno --setenv={harness} {emulate}")
    wait_for(lab.machine.path("/tmp/uno").is_symlink)
    assert "rules that were tried hold" in lab.script(tried)
    lab.script(f"systemd-run --unit=of-uno -p RuntimeDirectory=of-uno {run}")
    wait_for(lambda: "safe" in lab.script(STATUS_OF_UNO))
    assert "rules that were tried hold" in lab.script(f"export {harness}\n{alone}")
    # docs/hardware.md, as far as it goes without a board.
    assert "apt install avrdude" in _fails(lab.script, "armrig flash --dry-run", 1)


def _configuration(rig: str) -> str:
    """Return the configuration of the page, of an emulated rig."""
    text = CONFIGURATION.replace(BY_ID, f"/run/rig-{rig}/tty")
    return text.replace("[limits]", "watchdog_ms = 250\n[limits]")


def _score(lab: Lab, unit: str) -> str:
    judged = lab.script(f"systemd-analyze security --no-pager {unit} || true")
    (score,) = re.findall(r"Overall exposure level for \S+: ([0-9.]+)", judged)
    return str(score)


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
