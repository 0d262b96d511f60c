"""Public names of `armrig.rig`, which was one module before it became a room."""

from __future__ import annotations

import subprocess
import sys

import armrig
import pytest


def test_the_errors_of_a_rig_are_imported_from_the_room() -> None:
    from armrig.rig import (
        BusyError,
        NoReplyError,
        RefusedError,
        Rig,
        RigError,
        RunEndedError,
        replies,
        session,
    )

    assert Rig is armrig.Rig
    assert RigError is armrig.RigError
    assert (RefusedError, BusyError) == (replies.RefusedError, replies.BusyError)
    assert RunEndedError is replies.RunEndedError
    assert NoReplyError is session.NoReplyError


def test_a_name_that_the_room_has_not_is_refused() -> None:
    import armrig.rig

    with pytest.raises(AttributeError, match=r"'armrig\.rig' has no attribute 'Rug'"):
        armrig.rig.Rug  # noqa: B018


def test_a_module_of_the_room_does_not_load_zenoh() -> None:
    program = "import sys, armrig.lab.host; sys.exit('zenoh' in sys.modules)"

    done = subprocess.run([sys.executable, "-c", program], check=False)

    assert done.returncode == 0
