"""What the service says to whoever reads its log."""

from __future__ import annotations

import pytest
from armrig_daemon.service.sentences import print_line


def test_a_line_of_the_log_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    """What a client, a device or a file has put into it does nothing to a terminal."""
    print_line("armrigd: info: held by a\x1b[2J\nkernel: all is well\x9b")

    assert capsys.readouterr().err == (
        "armrigd: info: held by a\\x1b[2J\\nkernel: all is well\\x9b\n"
    )
