"""An attachment that was exchanged is found by its SHA-256 in the manifest."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import armrig
import msgspec
import numpy as np
import pytest
from armrig.cli import main
from armrig.recordings.files.origin import conversion_of, description_in
from armrig.recordings.files.replay import replay
from armrig.recordings.files.verification import verify
from armrig.recordings.overview import contents_facts
from armrig_core.commands.commands import RunRequest
from armrig_core.errors import FileError
from armrig_core.recording_file.manifest import (
    CALIBRATION,
    CALIBRATION_RAW,
    CONFIG,
    DESCRIPTION,
    INPUT,
    RUN,
    Manifest,
)
from armrig_core.rig.calibration import Calibration, Made, Potentiometer
from armrig_core.rig.calibration_file import raw_path, toml_of
from armrig_core.rig.description import Description, builtin
from armrig_daemon.config import Config, load
from armrig_daemon.service.virtual_service import LEASE, VirtualService
from mcap.reader import make_reader
from mcap.writer import Writer

NAMES = (CONFIG, CALIBRATION, DESCRIPTION, CALIBRATION_RAW, INPUT)
SAMPLES = b"samples of the calibration"
Change = Callable[[str, bytes], bytes | None]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a recording of the daemon with all five attachments."""
    folder = tmp_path_factory.mktemp("run")
    about: dict[str, str] = dict.fromkeys(("date", "rig", "device_uid", "armrig"), "1")
    made = Made(**about, raw_sha256=hashlib.sha256(SAMPLES).hexdigest())
    measured = Calibration(theta_1=Potentiometer(zero_counts=1000.0), made=made)
    (folder / "c.toml").write_text(toml_of(measured))
    raw_path(folder / "c.toml").write_bytes(SAMPLES)
    config = load([], {"ARMRIG_CALIBRATION_FILE": str(folder / "c.toml")}, {})
    return _recorded(config, folder, builtin("arm"))


def _recorded(config: Config, folder: Path, description: Description) -> Path:
    rig = VirtualService(config, folder, seed=3, description=description)
    u = np.linspace(0.5, 3.0, 200).tolist()
    return rig.record(RunRequest(lease=LEASE, n=0, u=u, experiment="blackbox", details={}))


def rewritten(source: Path, target: Path, change: Change, **fields: Any) -> Path:
    """Write a copy with other attachments (None: without it) and other fields in the manifest."""
    with source.open("rb") as read, target.open("wb") as written:
        reader, writer = make_reader(read), Writer(written)
        writer.start()
        for record in reader.iter_metadata():
            metadata = record.metadata
            if record.name == RUN:
                metadata = msgspec.structs.replace(Manifest.of(metadata), **fields).metadata()
            writer.add_metadata(record.name, metadata)
        for a in reader.iter_attachments():
            if (data := change(a.name, a.data)) is not None:
                writer.add_attachment(a.create_time, a.log_time, a.name, a.media_type, data)
        channels: dict[int, int] = {}
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert schema is not None
            if channel.id not in channels:
                own = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, "protobuf", own)
            times = message.log_time, message.data, message.publish_time, message.sequence
            writer.add_message(channels[channel.id], *times)
        writer.finish()
    return target


def _exchanged(name: str, old: bytes, new: bytes) -> Change:
    def change(attachment: str, data: bytes) -> bytes:
        changed = data.replace(old, new)
        assert attachment != name or changed != data
        return changed if attachment == name else data

    return change


EXCHANGED: Mapping[str, tuple[bytes, bytes]] = {
    CONFIG: (b'"u_max_v":5.0', b'"u_max_v":4.9'),
    CALIBRATION: (b'"zero_counts":1000.0', b'"zero_counts":2000.0'),
    DESCRIPTION: (b"per_count = 9.37", b"per_count = 1.87"),
    CALIBRATION_RAW: (b"samples", b"Samples"),
    INPUT: (b"u_v\n0.5\n", b"u_v\n0.7\n"),
}


def test_the_manifest_contains_the_hash_of_every_attachment(run: Path) -> None:
    with run.open("rb") as file:
        attached = {a.name: a.data for a in make_reader(file).iter_attachments()}

    manifest = armrig.load(run).manifest

    assert {*attached} == {*NAMES} == {*EXCHANGED}
    hashes = {name: hashlib.sha256(data).hexdigest() for name, data in attached.items()}
    assert manifest.attachment_hashes == hashes


def test_a_file_with_its_own_attachments_passes(run: Path, tmp_path: Path) -> None:
    copy = rewritten(run, tmp_path / "copy.mcap", lambda _, data: data)

    for path in (run, copy):
        checks = {check.about: check for check in verify(path).checks}
        assert checks["attachments"].level == "good"
        assert checks["attachments"].text == (
            "each has the hash in the manifest: calibration.csv.gz, calibration.json, "
            "config.json, input.csv and rig.toml"
        )
        assert armrig.load(path).unhashed == ()
    assert replay(copy).difference == ""


@pytest.mark.parametrize("name", NAMES)
def test_an_exchanged_attachment_is_refused(
    name: str, run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An exchanged rig.toml renamed the outputs, and an exchanged calibration scaled them."""
    path = rewritten(run, tmp_path / "run.mcap", _exchanged(name, *EXCHANGED[name]))
    said = (
        rf"run\.mcap: the attachment '{name}' is not that of this run: its SHA-256 begins with "
        r"[0-9a-f]{12}, in the manifest with [0-9a-f]{12}; copy the recording again"
    )

    for read in (armrig.load, verify, replay):
        with pytest.raises(FileError, match=said):
            read(path)
    with pytest.raises(FileError, match=said):
        armrig.load(path, start=0.5, stop=1.0)
    assert (conversion_of(path), description_in(path)) == (None, None)
    assert main(["verify", str(path)]) == 1
    assert f"the attachment '{name}' is not that of this run" in capsys.readouterr().err


def test_an_unfinished_file_with_an_exchanged_attachment_is_refused(
    run: Path, tmp_path: Path
) -> None:
    """A file that is cut off is not damaged: its beginning is as it was written."""
    path = rewritten(run, tmp_path / "run.mcap", _exchanged(INPUT, *EXCHANGED[INPUT]))
    path.write_bytes(path.read_bytes()[:-5000])

    with pytest.raises(FileError, match=r"the attachment 'input\.csv' is not that of this run"):
        armrig.load(path)


def test_a_wrong_hash_in_a_damaged_file_is_reported(run: Path, tmp_path: Path) -> None:
    """The damaged byte may be in the hash, so the samples remain readable."""
    spoilt = run.read_bytes()
    sha256 = hashlib.sha256(builtin("arm").text).hexdigest().encode()
    path = tmp_path / "run.mcap"
    path.write_bytes(spoilt.replace(sha256, b"0" * 64, 1))

    recording = armrig.load(path)

    assert recording.truncated
    assert "; the attachment 'rig.toml' is not that of this run: " in recording.damage
    failed = {c.about: c.text for c in verify(path).checks if c.level == "unusable"}
    assert failed["attachments"].startswith("the attachment 'rig.toml' is not that of this run")


def test_files_of_older_releases_load_with_a_note(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hashes = {key for key in Manifest.__struct_fields__ if key.endswith("_sha256")}
    none = dict.fromkeys(hashes - {"controller_sha256"}, "")  # older files have no such key
    change = _exchanged(INPUT, *EXCHANGED[INPUT])
    path = rewritten(run, tmp_path / "old.mcap", change, armrig="0.2.0", **none)

    old = armrig.load(path)

    assert old.unhashed == tuple(sorted(NAMES))
    said = "by armrig 0.2.0, contains no hash of calibration.csv.gz, calibration.json, config.json,"
    assert said in contents_facts(old)["remarks"][-1]
    found = {check.about: check for check in verify(path).checks}["attachments"]
    assert (found.level, said in found.text) == ("warning", True)
    assert main(["info", str(path)]) == 0
    assert said in " ".join(capsys.readouterr().out.split())


def test_a_missing_attachment_fails_the_verification(run: Path, tmp_path: Path) -> None:
    for name in NAMES[:2]:
        path = tmp_path / "run.mcap"
        rewritten(run, path, lambda n, data, gone=name: None if n == gone else data)

        found = {check.about: check for check in verify(path).checks}["attachments"]
        assert found.level == "unusable"
        assert found.text == f"missing, although the manifest contains the hash: {name}"


def test_a_recording_without_its_description_is_not_read_as_the_arms(tmp_path: Path) -> None:
    (tmp_path / "rc").mkdir()
    rc = _recorded(Config(), tmp_path / "rc", builtin("rc"))
    path = tmp_path / "rc.mcap"
    rewritten(rc, path, lambda name, data: None if name == DESCRIPTION else data)

    with pytest.raises(FileError, match=r"the attachment 'rig\.toml' is missing, but the manifest"):
        armrig.load(path)


def test_only_the_first_part_of_a_run_has_the_hash_of_the_input(run: Path, tmp_path: Path) -> None:
    of = {"part_k_first": 0}
    for part, names in ((1, {*NAMES}), (2, {*NAMES} - {INPUT})):
        path = tmp_path / f"part-{part}.mcap"
        keep: Change = lambda name, data, names=names: data if name in names else None  # noqa: E731
        rewritten(run, path, keep, part=part, **of)

        found = armrig.load(path)
        assert {*found.manifest.attachment_hashes} == names
        checks = {check.about: check for check in verify(path).checks}
        assert checks["attachments"].level == "good"
