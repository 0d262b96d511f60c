"""Public names of `armrig.report`, which was one module before it became a room."""

from __future__ import annotations

import pytest


def test_the_public_names_of_the_report_can_be_imported() -> None:
    from armrig.report import document, recording_facts, report, treatment

    assert report is document.report
    assert treatment is recording_facts.treatment


def test_an_unknown_name_of_the_report_is_refused() -> None:
    import armrig.report

    with pytest.raises(AttributeError, match=r"'armrig\.report' has no attribute 'raport'"):
        armrig.report.raport  # noqa: B018
