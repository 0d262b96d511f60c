"""The Uno's firmware as a file: the committed image equals the build, and fits."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from armrig_core.errors import OperationError
from armrig_core.rig.firmware_image import IMAGES, image_path
from armrig_daemon.command_line import app
from armrig_daemon.emulator.harness import Harness
from armrig_daemon.emulator.settings import firmware_image, harness_program

from tests.firmware.uno_host import HEX, ROOT
from tests.tools import needs

UNO = ROOT / "firmware_protocol" / "firmware" / "boards" / "uno"


@needs("avr-gcc")
@pytest.mark.parametrize("name", IMAGES)
def test_the_committed_image_equals_the_build_of_the_sources(name: str, tmp_path: Path) -> None:
    """To the byte; make fails if it exceeds 28 kB of flash."""
    image = tmp_path / "built.hex"

    subprocess.run(
        ["make", "-s", "-C", str(UNO), f"HEX={image}", f"BUILD={tmp_path}", f"LAYOUT={name}"],
        check=True,
        capture_output=True,
    )

    assert image.read_bytes() == image_path(name).read_bytes(), (
        "run `make firmware` and commit the image"
    )


def test_missing_harness_names_the_make_target(tmp_path: Path) -> None:
    with pytest.raises(OperationError, match="build it in a checkout by `make fil`") as error:
        harness_program({}, tmp_path)
    assert "\n" not in str(error.value)

    program = tmp_path / "fil"
    program.touch()
    assert harness_program({"ARMRIG_FIL": str(program)}, tmp_path / "elsewhere") == program


def test_a_harness_that_has_ended_is_closed_without_an_error(tmp_path: Path) -> None:
    harness = Harness(Path("/bin/true"), tmp_path, baud=500_000)
    assert harness._process.wait(30) == 0

    with pytest.raises(OperationError, match="the harness ended with exit code 0"):
        harness.reset()

    harness.close()


def test_an_error_names_a_missing_image(tmp_path: Path) -> None:
    with pytest.raises(OperationError, match=r"other\.hex: no such firmware"):
        firmware_image(tmp_path / "other.hex")


@pytest.mark.parametrize(
    "command", [["conformance"], ["emulate", "--port", "uno"], ["virtual", "--directory", "."]]
)
def test_a_truncated_image_is_refused_by_each_command_that_runs_it(
    command: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Otherwise simavr would run the file up to the cut."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ARMRIG_FIL", "/bin/true")  # a harness that ends at once
    image = tmp_path / "cut.hex"
    image.write_bytes(HEX.read_bytes()[: HEX.stat().st_size // 2 // 45 * 45])

    with pytest.raises(SystemExit) as ended:
        app([*command, "--hex", str(image)])

    assert ended.value.code not in (None, 0)
    (line,) = capsys.readouterr().err.splitlines()
    assert (
        f"{image}: not a firmware image in Intel HEX: it has no end; the file may be cut off"
        in line
    )
