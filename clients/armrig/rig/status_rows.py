"""Status of a daemon as rows of text, for `armrig status` and the dashboard."""

from __future__ import annotations

from typing import Any

from armrig_core.commands import StatusReport


def status_rows(report: StatusReport) -> list[tuple[str, str]]:
    """Return the names and values of a status as text; for a fault, also its cause and remedy.

    The texts may contain unprintable characters: escape them before printing.
    """
    last = report.last_run
    device = ", ".join(f"{name} {value}" for name, value in report.device.items())
    silent = report.line or ("" if device else "has not answered yet")
    return [
        ("rig", f"{report.rig}, armrig {report.version}, at {report.endpoint}"),
        ("phase", report.phase),
        *(
            row
            for row in (("fault", f"{report.fault}: {report.reason}"), ("to do", report.remedy))
            if report.reason
        ),
        *([("device", silent)] if silent else []),
        ("motor", report.motor or "not known"),
        ("owner", report.owner or "nobody"),
        (
            "last run",
            "none"
            if last is None
            else f"{last.recording}, {last.samples} samples, "
            + (last.outcome if last.finished else f"running; {last.synced} are on the disk"),
        ),
        ("recordings", report.recordings),
        ("Ts", f"{report.Ts:g} s"),
        ("limits", f"{report.u_min:g} to {report.u_max:g} V"),
        ("calibration", report.calibration or "not reported by this daemon"),
        ("arm", "removed, according to [arm] removed" if report.arm_removed else "mounted"),
        ("host", "; ".join(scheduling_sentences(report.host))),
        *([("device", device)] if not silent else []),
    ]


def scheduling_sentences(host: dict[str, Any]) -> list[str]:
    """Return the daemon's report on real-time scheduling as a list of sentences."""
    if not host:
        return ["not known yet"]
    fifo = host.get("fifo")
    sentences = [f"real-time scheduling at priority {fifo}" if fifo else "no real-time scheduling"]
    refused = host.get("refused", [])
    sentences += [
        f"not allowed: {what}" for what in (refused if isinstance(refused, list) else [refused])
    ]
    return sentences
