"""The columns of a batch's table: the same for all recordings, whatever came of each."""

from __future__ import annotations

from armrig.report.batch.tasks import Task, name_of

Kind = str
"""text, truth, count, number; texts and numbers are several in one cell."""

OF_THE_FILE: dict[str, Kind] = {
    "recording": "text",
    "bytes": "count",
    "modified_ns": "count",
}
"""Known without opening it; they tell whether a result is of the file that is there now."""
OF_THE_RUN: dict[str, Kind] = {
    "sha256": "text",
    "rig": "text",
    "device": "text",
    "run_id": "text",
    "experiment": "text",
    "started": "text",
    "Ts": "number",
    "samples": "count",
    "missing": "count",
    "calibration_sha256": "text",
    "recorded_by": "text",
    "damage": "text",
}
OF_THE_RESULT: dict[str, Kind] = {"problem": "text", "doubts": "texts"}
"""`problem` says why there is no result; "" where there is one."""
CHECKS = ("file", "samples", "envelope", "input", "timing", "configuration", "clock")
"""What `armrig verify` checks; a column for each result and one for what was found."""
OF_THE_TASK: dict[str, dict[str, Kind]] = {
    "identify": {
        "structure": "text",
        "nk": "count",
        "integrator": "truth",
        "output": "text",
        "N": "count",
        "fit_percent": "number",
        "noise_variance": "number",
        "loss": "number",
        "fpe": "number",
        "p_white": "number",
        "converged": "truth",
        "names": "texts",
        "parameters": "numbers",
        "std": "numbers",
        "std_robust": "numbers",
        "warnings": "texts",
        "model": "text",
    },
    "validate": {
        "model_of": "text",
        "output": "text",
        "on_estimation_data": "truth",
        "fit_percent": "number",
        "rms_error": "number",
        "velocity_fit_percent": "number",
        "p_white": "number",
        "p_no_dynamics_missing": "number",
        "p_no_feedback": "number",
    },
    "verify": {"passed": "truth"}
    | {f"{check}_{column}": "text" for check in CHECKS for column in ("result", "found")},
    "report": {
        "report": "text",
        "report_sha256": "text",
        "validated_by": "text",
        "best": "text",
        "rms_error": "number",
    },
}


def columns_of(task: Task) -> dict[str, Kind]:
    """Return the columns of a task's table, in their order, and what each holds."""
    return {**OF_THE_FILE, **OF_THE_RUN, **OF_THE_RESULT, **OF_THE_TASK[name_of(task)]}
