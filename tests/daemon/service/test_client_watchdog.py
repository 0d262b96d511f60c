"""Signs of a run's client: only its own and only new ones count, and silence has an end."""

from __future__ import annotations

from math import inf

import pytest
from armrig_core.commands import Renew, Run
from armrig_daemon.service.client_watchdog import begun, renewed

LEASE = "a" * 32
RUN = Run(lease=LEASE, n=3, u=[1.0], dead_man=2.0)


def test_a_client_counts_as_gone_a_period_after_its_newest_sign() -> None:
    presence = begun(RUN, 100.0)

    assert presence.gone_s == 102.0
    assert renewed(presence, Renew(lease=LEASE, n=4), 101.5).gone_s == 103.5


def test_a_run_without_a_dead_man_needs_nobody() -> None:
    presence = begun(Run(lease=LEASE, n=3, u=[1.0]), 100.0)

    assert presence.gone_s == inf
    assert renewed(presence, Renew(lease=LEASE, n=4), 200.0).gone_s == inf


@pytest.mark.parametrize(
    ("sign", "complaint"),
    [
        (Renew(lease="b" * 32, n=4), "no run of this lease is planned or running"),
        (Renew(lease=LEASE, n=3), "n=3 must be greater than the last, 3"),
    ],
)
def test_another_s_sign_and_an_old_one_are_none(sign: Renew, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        renewed(begun(RUN, 100.0), sign, 101.0)
    with pytest.raises(ValueError, match="no run of this lease"):
        renewed(None, sign, 101.0)


def test_a_sign_that_is_played_again_keeps_nothing_alive() -> None:
    presence = renewed(begun(RUN, 100.0), Renew(lease=LEASE, n=7), 101.0)

    with pytest.raises(ValueError, match="n=7 must be greater than the last, 7"):
        renewed(presence, Renew(lease=LEASE, n=7), 102.0)
