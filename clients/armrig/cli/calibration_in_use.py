"""The end of `armrig calibrate`: the running daemon takes the calibration, where that is wanted."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from shlex import quote

import platformdirs
import typer
from armrig_core.calibration_file import raw_path

from armrig.cli.next_step import say_to_copy
from armrig.cli.options import tell

_QUESTION = "Use it now? The running daemon takes it"


def take_into_use(
    path: Path, *, wanted: bool | None, asks: bool, rig: str, connect: str | None
) -> bool:
    """Return whether the running daemon uses the calibration in `path`; say how it stays in use.

    Parameters
    ----------
    wanted : bool, optional
        Whether the daemon is to take it. None asks the person, where there is a daemon.
    asks : bool
        Whether the person may be asked; else the answer is yes.

    Raises
    ------
    RigError
        The daemon refuses it, or does not answer where `wanted` is true.
    """
    from armrig.rig.client import Rig
    from armrig.rig.collection import refusal_sentence, reset_command
    from armrig.rig.replies import RefusedError
    from armrig.rig.session import NoReplyError, RigError

    named, is_used = "", False
    try:
        with Rig(rig, connect=connect) as opened:
            named = opened.status().calibration_file
            is_used = _is_wanted(wanted, asks=asks)
            if is_used:
                opened.calibrate(path)
    except RefusedError as err:
        why = refusal_sentence(err, reset_command(rig, connect))
        raise RigError(f"{path} is written, but not in use: {why}") from err
    except NoReplyError:
        if wanted:
            raise
        is_used = False
        tell(f"not in use: no daemon of rig {rig} answers")
    if is_used:
        tell(f"rig {rig} uses it from the next sample on, until `armrig lab` or armrigd ends")
    _say_how_it_stays(path, named)
    return is_used


def _is_wanted(wanted: bool | None, *, asks: bool) -> bool:
    """Return whether the running daemon is to take it; say so where it is not."""
    if wanted is None and asks and not sys.stdin.isatty():
        tell("not in use: --use has the running daemon take it")
        return False
    if wanted is None:
        wanted = not asks or typer.confirm(_QUESTION, default=True, err=True)
    if not wanted:
        tell("not in use")
    return wanted


def _say_how_it_stays(path: Path, named: str) -> None:
    """Say how the daemon uses it from its next start on; `named` is what it reads then by now."""
    path = path.absolute()
    if named == str(path):
        tell("armrigd reads this very file at its next start, too")
        return
    if named:
        pairs = [(path, Path(named)), (raw_path(path), raw_path(Path(named)))]
        copies = [f"cp {quote(str(a))} {quote(str(b))}" for a, b in pairs]
        tell(f"armrigd reads {named} at its next start; to have it read this one:")
        say_to_copy(" && ".join(copies))
        return
    configuration = Path(platformdirs.user_config_dir("armrig")) / "armrig.toml"
    name = path.name if path.parent == configuration.parent else str(path)
    tell(f"to have armrigd use it from its next start on, add to {configuration}:")
    say_to_copy(f"[calibration]\nfile = {json.dumps(name, ensure_ascii=False)}")
