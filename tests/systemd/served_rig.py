"""A rig of the machine, and the unit that serves it."""

from __future__ import annotations

from dataclasses import dataclass

from tests.integration.processes import complete_lines
from tests.systemd.machine import Machine, wait_for

_RUNNER = """
import sys, time
import armrig
from armrig.rig.client import RefusedError
with armrig.Rig(sys.argv[1], connect=sys.argv[2]) as rig:
    for _ in range(100):
        try:  # on a busy machine it may be refused for a moment
            rig.arm("group 3", Ts=0.01)
            break
        except RefusedError:
            time.sleep(0.2)
    rig.run([1.0, 4.0] * 3000)
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rig:
    """One rig of the machine: an emulator at a port, and the unit that serves it."""

    machine: Machine
    id: str

    @property
    def unit(self) -> str:
        """Name of the daemon's unit."""
        return f"armrigd@{self.id}.service"

    @property
    def endpoint(self) -> str:
        """Return the endpoint of the daemon."""
        return f"unixsock-stream//run/armrig/{self.id}/{self.id}.sock"

    def armrig(self, *command: str, user: str = "", check: bool = True) -> tuple[int, str, str]:
        """Run a command of `armrig` on this rig; return its exit code and output."""
        where = ("--rig", self.id, "--connect", self.endpoint)
        done = self.machine.run("armrig", *command, *where, user=user, check=check)
        return done.returncode, done.stdout, done.stderr

    def volts(self) -> list[float]:
        """Return the voltages at the motor's terminals, as the emulator's witness saw them."""
        text = self.machine.path(f"/run/rig{self.id}/trace.csv").read_text()
        fields = [line.split(",") for line in complete_lines(text)]
        return [float(volts) for t, volts, *_ in fields if t.isdigit()]

    def is_active(self) -> bool:
        """Return whether the unit serves."""
        return self.machine.shown(self.unit, "ActiveState")["ActiveState"] == "active"

    def status(self) -> str:
        """Return the state that the daemon reports to systemd; empty without a daemon."""
        return self.machine.shown(self.unit, "StatusText")["StatusText"]

    def phase(self) -> str:
        """Return the phase of the daemon, or nothing where its device does not answer."""
        return self.status().split(",")[0].split(":")[0].removeprefix("not ready")

    def main_pid(self) -> str:
        """Return the daemon's process, as the machine counts."""
        return self.machine.shown(self.unit, "MainPID")["MainPID"]

    def loop_pid(self) -> str:
        """Return the loop's process."""
        command = "pgrep", "-P", self.main_pid(), "-f", "armrig_daemon.loop.process"
        return self.machine.run(*command).stdout.strip()

    def drive(self) -> None:
        """Have a client run the motor at 1 V and 4 V in turn for a minute; it turns."""
        command = ["python", "-c", _RUNNER, self.id, self.endpoint]
        enough = len(self.volts()) + 20
        self.machine.run("systemd-run", "--quiet", f"/opt/armrig/bin/{command[0]}", *command[1:])
        wait_for(lambda: len(self.volts()) > enough or self.phase() == "fault")
        assert len(self.volts()) > enough, self.status()

    def said(self) -> list[tuple[str, str]]:
        """Return the daemon's lines of the journal: priority and text."""
        journal = self.machine.journal(self.unit)
        return [(line["PRIORITY"], line["MESSAGE"]) for line in journal]

    def start(self) -> None:
        """Have the unit serve, with the rig at 0 V and without a holder."""
        self.machine.systemctl("reset-failed", self.unit, check=False)
        self.machine.systemctl("start", self.unit)
        wait_for(lambda: self.phase() not in ("", "init"))
        if self.phase() != "safe":
            self.armrig("stop")
            self.armrig("reset")
        wait_for(lambda: self.status() == "safe, nobody has it")
