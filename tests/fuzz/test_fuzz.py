"""A short run of each fuzzer; `make fuzz` is the long one."""

from __future__ import annotations

from pathlib import Path

import pytest
from armrig_core.commands.commands import SetRequest

from tests.fuzz import bombs, cuts, data_files, files, frames, recoveries, requests
from tests.sampling import sampled


def test_any_bytes_are_decoded_to_frames_or_reported_as_spoilt() -> None:
    found = frames.fuzz(500_000, seed=1)

    kinds = {message.__name__ for message in frames.MESSAGES.values()}
    assert kinds | {"Spoilt", "Unknown"} | {"bytes"} == set(found)


def test_any_fields_of_a_command_are_accepted_or_refused() -> None:
    found = requests.fuzz(10_000, seed=1)

    assert found["taken"] > 150
    assert found["refused"] > 7_500
    with pytest.raises(AssertionError):
        requests.check(SetRequest(lease="a" * 32, n=0, u=5.1))


def test_any_file_is_read_from_its_beginning_or_refused_in_one_line() -> None:
    found = files.fuzz(500, seed=1)

    assert found["cut"] > 250
    assert found["whole"] > 50
    assert found["refused"] > 12


def test_any_unfinished_file_is_recovered_or_unchanged() -> None:
    found = recoveries.fuzz(200, seed=1)

    assert found["recovered"] > 120
    assert found["refused"] > 5  # also complete files: their samples are found by the index


def test_any_file_of_data_is_read_or_refused_in_one_line() -> None:
    found = data_files.fuzz(600, seed=1)

    assert found["read"] > 50
    assert found["refused"] > 200


def test_a_recording_cut_anywhere_is_read_up_to_its_last_flush() -> None:
    """L3: at the edges of each flush and elsewhere; the long run cuts at every byte."""
    found = cuts.near_edges(150, seed=1)

    assert found["cut"] > 150
    assert found["refused"] < 20  # before the run's manifest there is nothing
    assert found["whole"] == 1


@pytest.mark.parametrize("name", sampled(["1 GiB in one chunk", "events", "timing"]))
def test_a_file_made_to_cost_memory_costs_64_mib_at_most(name: str, tmp_path: Path) -> None:
    cost = bombs.cost_mib(bombs.BOMBS[name](), tmp_path)

    assert 0.1 < cost <= bombs.MOST_MIB  # it was read at all
