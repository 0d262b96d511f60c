"""The wheel contains image, descriptions of rigs and glossary, and nothing of the GPL harness."""

from __future__ import annotations

import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest
from armrig_core.rig.description import builtin_files
from armrig_core.rig.firmware_image import IMAGES, image_path

ROOT = Path(__file__).parents[2]
IMAGE = "armrig_core/firmware/armrig-uno.hex"
builders = pytest.importorskip("hatchling.builders.wheel", reason="no hatchling")
sdists = pytest.importorskip("hatchling.builders.sdist", reason="no hatchling")


def _wheel(root: Path, folder: Path) -> dict[str, bytes]:
    """Return the files of the wheel that is built of a tree, and leave them in `folder`."""
    (path,) = builders.WheelBuilder(str(root)).build(directory=str(folder))
    with zipfile.ZipFile(path) as wheel:
        wheel.extractall(folder)
        return {name: wheel.read(name) for name in wheel.namelist()}


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a folder for the files of the wheel."""
    return tmp_path_factory.mktemp("wheel")


@pytest.fixture(scope="module")
def wheel(unpacked: Path) -> dict[str, bytes]:
    """Give the files of the wheel of this checkout."""
    return _wheel(ROOT, unpacked)


def test_the_firmware_is_in_the_wheel(wheel: dict[str, bytes]) -> None:
    for name in IMAGES:
        image = image_path(name)
        assert wheel[f"armrig_core/firmware/{image.name}"] == image.read_bytes()


def test_the_descriptions_of_rigs_are_in_the_wheel(wheel: dict[str, bytes]) -> None:
    shipped = {name for name in wheel if name.startswith("armrig_core/rigs/")}

    assert shipped == {f"armrig_core/rigs/{path.stem}.toml" for path in builtin_files()}


@pytest.mark.usefixtures("wheel")
def test_an_installed_armrig_finds_its_glossary_and_its_firmware(unpacked: Path) -> None:
    program = (
        "from armrig.cli.glossary import _page; "
        "from armrig_core.rig.firmware_image import image_path; print(_page(), image_path())"
    )
    found = subprocess.run(
        [sys.executable, "-c", program],
        env={"PYTHONPATH": str(unpacked)},
        capture_output=True,
        text=True,
        check=True,
    )

    page, image = map(Path, found.stdout.split())
    assert page == unpacked / "armrig" / "glossary.md"
    assert page.read_bytes() == (ROOT / "docs" / "glossary.md").read_bytes()
    assert image == unpacked / IMAGE


def test_no_file_of_the_test_harness_is_in_the_wheel(wheel: dict[str, bytes]) -> None:
    """The harness is GPL."""
    harness = {path.read_bytes() for path in (ROOT / "firmware_protocol" / "simavr").glob("*.[ch]")}

    assert len(harness) > 5
    assert not harness & set(wheel.values())
    assert not [name for name in wheel if "fil/" in name or name.endswith((".c", ".h"))]
    assert not [name for name, data in wheel.items() if b"GPL-3" in data]


@pytest.mark.exhaustive
def test_a_wheel_of_the_source_archive_is_the_same(wheel: dict[str, bytes], tmp_path: Path) -> None:
    (path,) = sdists.SdistBuilder(str(ROOT)).build(directory=str(tmp_path))
    with tarfile.open(path) as archive:
        # Debian 12 has no filter; Python 3.12 and 3.13 warn if there is none.
        archive.extraction_filter = getattr(tarfile, "data_filter", None)
        archive.extractall(tmp_path / "source")
    (source,) = (tmp_path / "source").iterdir()

    of_archive = _wheel(source, tmp_path)

    assert of_archive.keys() == wheel.keys()
    assert of_archive[IMAGE] == wheel[IMAGE]
