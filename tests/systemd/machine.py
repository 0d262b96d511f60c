"""A machine with systemd as its PID 1, in namespaces of its own; the host is not touched.

Its root is the host's under a layer of memory, so that nothing is downloaded. Its /etc has none of
the host's units, and /opt/armrig is an installation of this checkout. Alternatively the root is
another system's, unchanged.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

CHECKOUT = Path(__file__).parents[2]
WITHIN_S = 30.0
FETCHED_S = 600.0
_CAP_SYS_RESOURCE = 24  # <linux/capability.h>
_HOST = Path("/")
_SCRIPT = Path(__file__).with_name("machine.sh")
_NAMESPACES = ("--cgroup", "--mount", "--pid", "--fork", "--uts", "--ipc", "--net")
_OURS = ("firmware_protocol", "daemon", "clients")
_PROGRAM = """#!/opt/armrig/bin/python
import sys
from {module} import main
sys.exit(main())
"""


def missing() -> str:
    """Return the reason why there can be no such machine here, or nothing."""
    if os.geteuid() != 0:
        return "a machine of its own needs root (namespaces)"
    for program in ("unshare", "nsenter", "setpriv", "systemctl", "systemd-analyze"):
        if shutil.which(program) is None:
            return f"{program} is not installed"
    if not Path("/lib/systemd/systemd").exists():
        return "systemd is not installed"
    if subprocess.run(["unshare", *_NAMESPACES, "true"], check=False).returncode != 0:
        return "namespaces are not permitted, as in a container without privileges"
    return ""


def wait_for(what: Callable[[], object], within_s: float = WITHIN_S) -> float:
    """Wait until `what` is true; return how long it took, in s."""
    begun = time.monotonic()
    while not what():
        assert time.monotonic() < begun + within_s, "it did not happen in time"
        time.sleep(0.02)
    return time.monotonic() - begun


class Machine:
    """A running machine."""

    def __init__(self, root: Path = _HOST) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="armrig-machine-"))
        self._cgroup = _cgroups() / self._folder.name
        self._cgroup.mkdir()
        start = f"echo $$ > {self._cgroup}/cgroup.procs; exec unshare {' '.join(_NAMESPACES)} "
        start += f"--kill-child sh {_SCRIPT} {self._folder} {root} {CHECKOUT} {sys.base_prefix}"
        self._unshare = subprocess.Popen(["sh", "-c", start], stdin=subprocess.DEVNULL)
        self._pid = 0
        try:
            wait_for(self._is_up)
            if root == _HOST:
                self._install()
        except BaseException:
            self.end()
            raise

    def _is_up(self) -> bool:
        assert self._unshare.poll() is None, "the machine did not start"
        children = Path(f"/proc/{self._unshare.pid}/task/{self._unshare.pid}/children")
        pids = children.read_text().split()
        if not pids or Path(f"/proc/{pids[0]}/comm").read_text() != "systemd\n":
            return False
        self._pid = int(pids[0])
        state = self.run("systemctl", "is-system-running", check=False).stdout.strip()
        return state in ("running", "degraded")

    def _install(self) -> None:
        """Make /opt/armrig of the checkout, with the packages of this environment."""
        version = f"python{sys.version_info.major}.{sys.version_info.minor}"
        self.run(f"/opt/python/bin/{version}", "-m", "venv", "--without-pip", "/opt/armrig")
        site = Path(sysconfig.get_path("purelib"))
        own = site.relative_to(CHECKOUT) if site.is_relative_to(CHECKOUT) else None
        packages = Path("/opt/checkout") / own if own else site
        paths = [f"/opt/checkout/{name}" for name in _OURS] + [str(packages)]
        target = Path("/opt/armrig/lib") / version / "site-packages/checkout.pth"
        self.write(target, "".join(f"{path}\n" for path in paths))
        for name, module in (("armrigd", "armrig_daemon.__main__"), ("armrig", "armrig.cli")):
            self.write(Path("/opt/armrig/bin") / name, _PROGRAM.format(module=module), 0o755)

    def run(
        self, *command: str, user: str = "", check: bool = True, online: bool = False
    ) -> subprocess.CompletedProcess[str]:
        """Run a command in the machine, as root or as another of its users.

        An online command has the host's network, and time to fetch packages.
        """
        enter = ["nsenter", "-t", str(self._pid), "-m", "-u", "-i", "-p", "-C"]
        enter += ["--"] if online else ["-n", "--"]
        if user:
            enter += ["setpriv", f"--reuid={user}", f"--regid={user}", "--init-groups"]
        clean = ["env", "-i", "-C", "/", "PATH=/opt/armrig/bin:/usr/sbin:/usr/bin:/sbin:/bin"]
        if online:  # as this host fetches packages
            clean += [f"{key}={value}" for key, value in os.environ.items() if key[:4] == "PIP_"]
        done = subprocess.run(
            [*enter, *clean, "HOME=/tmp", "OPENBLAS_NUM_THREADS=1", *command],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=FETCHED_S if online else 120,
            check=False,
        )
        assert not check or done.returncode == 0, f"{command}: {done.stdout}{done.stderr}"
        return done

    def write(self, path: Path, text: str, mode: int = 0o644) -> None:
        """Write a file of the machine."""
        inside = self.path(path)
        inside.parent.mkdir(parents=True, exist_ok=True)
        inside.write_text(text)
        inside.chmod(mode)

    def path(self, path: Path | str) -> Path:
        """Return how a file of the machine is reached from here."""
        return Path(f"/proc/{self._pid}/root") / str(path).lstrip("/")

    @property
    def may_raise_limits(self) -> bool:
        """Return whether its systemd can give LimitRTPRIO=, which a container may prevent."""
        status = Path(f"/proc/{self._pid}/status").read_text()
        return bool(int(status.split("CapEff:")[1].split()[0], 16) >> _CAP_SYS_RESOURCE & 1)

    def systemctl(self, *arguments: str, check: bool = True) -> subprocess.CompletedProcess[str]:
        """Ask the machine's systemd."""
        return self.run("systemctl", "--no-pager", *arguments, check=check)

    def shown(self, unit: str, *names: str) -> dict[str, str]:
        """Return what systemd knows of a unit."""
        text = self.systemctl("show", unit, *(f"--property={name}" for name in names)).stdout
        return dict(line.split("=", 1) for line in text.splitlines())

    def journal(self, unit: str) -> list[dict[str, Any]]:
        """Return a unit's own lines of the journal, the oldest first."""
        self.run("journalctl", "--sync")
        said = self.run("journalctl", "--no-pager", "-o", "json", f"_SYSTEMD_UNIT={unit}").stdout
        return [json.loads(line) for line in said.splitlines()]

    def end(self) -> None:
        """End the machine and all its processes."""
        self._unshare.kill()  # its child is killed with it, and a machine with its PID 1
        self._unshare.wait()
        wait_for(lambda: "populated 0" in (self._cgroup / "cgroup.events").read_text())
        for folder, _, _ in os.walk(self._cgroup, topdown=False):
            Path(folder).rmdir()
        self._folder.rmdir()


def _cgroups() -> Path:
    """Return where the unified hierarchy of control groups is mounted."""
    unified = Path("/sys/fs/cgroup/unified")
    return unified if unified.exists() else Path("/sys/fs/cgroup")
