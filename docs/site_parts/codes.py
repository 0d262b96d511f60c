"""Reference of the codes: faults with their remedy, refusals, outcomes of runs, and gaps."""

from __future__ import annotations

import ast
import inspect
from enum import StrEnum
from typing import Any

from armrig_core.commands.codes import GapCode, OutcomeCode, RefusalCode
from armrig_daemon.decisions.faults import OF_DEVICE, REMEDIES, Id
from armrig_protocol.messages import Cause

from site_parts.pages import GENERATED, table, write_page


def meanings(codes: type[StrEnum]) -> dict[str, str]:
    """Return the docstring of each member, as one line; the keys are the values of the members."""
    found, last = {}, ""
    for line in ast.iter_child_nodes(ast.parse(inspect.getsource(codes)).body[0]):
        if isinstance(line, ast.Assign) and isinstance(line.targets[0], ast.Name):
            last = codes[line.targets[0].id].value
        elif isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant) and last:
            found.setdefault(last, " ".join(str(line.value.value).split()))
    return found


def page() -> str:
    """Return the page of all codes."""
    found = meanings(Id)
    faults = [(f"`{i}`", found[i], f"{REMEDIES[i][0].upper()}{REMEDIES[i][1:]}.") for i in Id]
    device = [
        (f"`{Cause(cause).name}`", f"The device stopped: {text}.")
        for cause, text in OF_DEVICE.items()
    ]
    text = [
        "# Faults and codes",
        "After this page you can remedy a fault, and write a program that handles codes. "
        "`armrig status` shows the fault of a rig, and `armrig reset` clears it.",
        "## Faults",
        table(("Code", "Meaning", "Remedy"), *faults),
        "## Causes for which a device stops by itself",
        "The fault is then `device`, and its message contains the cause. After `WATCHDOG`, check "
        "the cable, keep the host from sleeping, and lower its load (`armrig doctor`). Then type "
        "`armrig reset`.",
        table(("Cause", "Meaning"), *device),
    ]
    for title, codes in (
        ("Refusals of a command", RefusalCode),
        ("Outcomes of a run", OutcomeCode),
        ("Gaps in a recording", GapCode),
    ):
        rows = [(f"`{code}`", meaning) for code, meaning in meanings(codes).items()]
        text += [f"## {title}", table(("Code", "Meaning"), *rows)]
    return "\n\n".join(text) + "\n"


def setup(app: Any) -> dict[str, bool]:
    """Generate the page before Sphinx looks for its sources."""
    app.connect("config-inited", lambda *_: write_page(GENERATED / "codes.md", page()))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
