"""The service's view of its rig: the newest reports of the loop, and the load of this host."""

from __future__ import annotations

from importlib.metadata import version
from math import nan
from pathlib import Path
from typing import Any

from armrig_core.commands.commands import LastRun, Refused, StatusReport
from armrig_core.process.standstill import boot_ns
from armrig_core.rig.calibration import Calibration
from armrig_core.rig.description import Description, builtin
from armrig_core.telemetry.telemetry import Sample
from msgspec import UNSET
from msgspec.structs import replace

from armrig_daemon.config import Config
from armrig_daemon.pipe import State, Timing
from armrig_daemon.service import readings
from armrig_daemon.service.host import pressure

_VERSION = version("armrig")  # read once, because it is read from a file
_UNKNOWN = State(t_host_ns=0, phase="init", reason="", owner="", ts_us=0, device={})


class RigView:
    """Newest reports of the loop about the rig."""

    def __init__(
        self, config: Config, endpoint: str, directory: Path, description: Description | None = None
    ) -> None:
        """Create the view before the first report; default: the description of the arm."""
        self.description = description or builtin("arm")
        """Description of the rig."""
        self.state = _UNKNOWN
        """Newest state that the loop has reported."""
        self.host: dict[str, Any] = {}
        """Requests of the loop that the kernel granted, and requests that the kernel refused."""
        self._config = config
        self._calibration = config.calibration_sentence
        made = config.calibration.made
        self._calibration_file = made.file if made else ""
        self._endpoint = endpoint
        self._directory = directory
        self._note_channels()
        self._turns_per_volt_s = config.arm.turns_per_volt_s if self.description.arm else 0.0
        self._readings = readings.ReadingSummary()
        self._timing: Timing | None = None
        self._pressure = nan, -1
        self.load = pressure.load()
        """Newest known load of the processors, as text for a person."""

    @property
    def is_known(self) -> bool:
        """True once the loop has reported a state."""
        return self.state is not _UNKNOWN

    @property
    def line(self) -> str:
        """Port, and the reason why no device answers; empty if a device answers."""
        line = self.state.line
        return f"{self._config.device.port}: {line}" if line else ""

    @property
    def calibration_sha256(self) -> str:
        """Hash of the calibration in force."""
        return self._config.calibration_sha256

    @property
    def start_rad(self) -> float | None:
        """Angle of the turning shaft, in rad; None if it is not known."""
        return readings.start_rad(self._readings)

    def note_calibration(self, calibration: Calibration) -> None:
        """Store a new calibration that the loop has accepted."""
        # The stored readings are in counts, and stay valid.
        self._config = replace(self._config, calibration=calibration)
        self._note_channels()
        date = calibration.made.date if calibration.made else ""
        self._calibration = f"sent by `armrig calibrate`, made {date}; in force until armrigd ends"

    def _note_channels(self) -> None:
        """Store the channels that are read, their limits, and which is of a turning shaft."""
        self._channels = self._config.channels(self.description)
        self._ranges = self._config.ranges(self.description)
        self._turning = next((n for n, channel in enumerate(self._channels) if channel.turns), 0)

    def note_sample(self, sample: Sample) -> None:
        """Update the view with a sample."""
        self._readings = readings.update_readings(self._readings, sample, self._turning)

    def note_timing(self, timing: Timing) -> Timing:
        """Store the timing of the last second; return it together with the load of this machine."""
        share, runnable = self._pressure
        self._timing = replace(timing, cpu_pressure_percent=share, run_queue=runnable)
        return self._timing

    def note_load(self, share: float, runnable: int, text: str) -> None:
        """Store the load of this machine; see `armrig_daemon.service.host.pressure`."""
        self._pressure, self.load = (share, runnable), text

    def objection(self) -> Refused | None:
        """Return the refusal of an arming because of the readings or a late host; else None."""
        config = self._config
        return readings.objection(
            self._readings,
            self._channels,
            turns_per_volt_s=self._turns_per_volt_s,
            is_described=not self.description.is_calibrated,
        ) or pressure.untimely(self._timing, config.device.watchdog_ms, self.load)

    def status(self, last_run: LastRun | None) -> StatusReport:
        """Return the status of the daemon and the rig."""
        config, state = self._config, self.state
        return StatusReport(
            rig=config.rig.id,
            version=_VERSION,
            phase=state.phase,
            reason=state.reason,
            fault=state.fault,
            motor=state.motor,
            remedy=state.remedy,
            owner=state.owner,
            Ts=(state.ts_us or config.ts_us) / 1e6,
            u_min=config.limits.u_min_v,
            u_max=config.limits.u_max_v,
            endpoint=self._endpoint,
            device=state.device,
            line=self.line,
            host=self.host,
            last_run=last_run,
            recordings=str(self._directory),
            calibration=self._calibration,
            calibration_sha256=config.calibration_sha256,
            calibration_file=self._calibration_file,
            arm_removed=config.arm.removed,
            owner_checked=state.owner_checked,
            limits=self._ranges,
            now_ns=boot_ns(),
            description=self.description.text.decode() if config.rig.file else UNSET,
        )
