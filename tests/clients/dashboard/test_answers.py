"""Answers to the page after an error: a mistake of the page, or a fault of armrig."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest
from armrig.dashboard.app import answered, application
from armrig.dashboard.driver import BusyDriverError
from armrig.rig.session import RigError
from armrig_core.errors import InputError, ParameterError
from starlette.routing import Route

from tests.clients.dashboard.asking import asked


def _of_numpy(_: bytes) -> Any:
    np.zeros(2) + np.zeros(3)


def _raises(error: Exception) -> Any:
    def does(_: bytes) -> Any:
        raise error

    return does


@pytest.mark.parametrize(
    ("does", "status", "said"),
    [
        (_of_numpy, 500, b"internal error, please report it: ValueError: operands"),
        (_raises(InputError("u is 9 V:\n 0 to 5 V")), 400, b'{"error":"u is 9 V: 0 to 5 V"}'),
        (_raises(ParameterError("at", "9", "too late")), 400, b'{"error":"step at 9: too late"}'),
        (_raises(ParameterError("Ts", "9", "no")), 400, b'{"error":"sampling time 9: no"}'),
        (_raises(ParameterError("seconds", "0", "no")), 400, b'{"error":"length 0: no"}'),
        (_raises(ParameterError("a", "2", "no")), 400, b'{"error":"a 2: no"}'),
        (_raises(BusyDriverError("wait")), 409, b'{"error":"wait"}'),
        (_raises(RigError("gone")), 502, b'{"error":"gone"}'),
    ],
)
def test_an_error_is_reported_in_a_sentence_or_as_an_internal_error(
    does: Any, status: int, said: bytes
) -> None:
    app = application([Route("/does", answered(does), methods=["POST"])])
    logged = pytest.raises(ValueError, match="operands") if status == 500 else nullcontext()

    found: tuple[int, bytes] = (status, said)
    with logged:
        found = asked(app, "/does")

    assert (found[0], found[1][: len(said)]) == (status, said)


def test_an_unknown_address_is_refused_in_one_line() -> None:
    app = application([Route("/does", answered(_of_numpy), methods=["POST"])])

    assert asked(app, "/did") == (404, b'{"error":"no such address"}')
    assert asked(app, "/does", method="GET") == (405, b'{"error":"405: Method Not Allowed"}')
