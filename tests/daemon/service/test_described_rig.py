"""A described rig names its channels in schema and recording, and converts by its file."""

from __future__ import annotations

from math import isnan
from pathlib import Path
from typing import Any

import pytest
from armrig_core.commands.commands import RunRequest
from armrig_core.recording_file.manifest import DESCRIPTION, RUN, Manifest, description_of
from armrig_core.rig.description import Description, builtin, path_of
from armrig_core.rig.firmware_image import image_crcs
from armrig_daemon.config import Config, RigIdentity, load
from armrig_daemon.config import description_of as configured
from armrig_daemon.decisions.state import Image
from armrig_daemon.service.virtual_service import LEASE, VirtualService
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from msgspec import UNSET, UnsetType

RC = builtin("rc")
TWO = Description.of(
    b'[rig]\nname = "two"\n'
    b'[outputs.T]\nunit = "\xc2\xb0C"\nzero_counts = 100.0\nper_count = 0.5\n'
    b'[outputs.flow]\nunit = "l/min"\nper_count = -2.0\n'
)


def _recorded(folder: Path, description: Description) -> tuple[list[Any], dict[str, str], bytes]:
    """Return samples, metadata and attached description of a run on an emulated rig."""
    config = Config(rig=RigIdentity(file=str(folder / "rig.toml")))
    service = VirtualService(config, folder, seed=1, description=description)
    path = service.record(RunRequest(lease=LEASE, n=0, u=[1.0] * 50, experiment="own"))
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        samples = [m for _, c, _, m in reader.iter_decoded_messages() if c.topic.endswith("sample")]
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        attached = {a.name: a.data for a in reader.iter_attachments()}
    return samples, metadata[RUN], attached[DESCRIPTION]


def test_the_schema_of_a_recording_has_the_names_and_units_of_the_rig(tmp_path: Path) -> None:
    samples, metadata, attached = _recorded(tmp_path, TWO)
    assert str(tmp_path).encode() not in b"".join(p.read_bytes() for p in tmp_path.iterdir())

    first = samples[0]
    assert [field.name for field in first.DESCRIPTOR.fields] == [
        *("k", "t_sched_ns", "t_host_ns", "t_device_us", "T_degC", "flow_l_per_min"),
        *("u_cmd_v", "u_applied_v", "T_counts", "flow_counts", "flags"),
    ]
    assert all(s.T_degC == (s.T_counts - 100) * 0.5 for s in samples)
    assert all(s.flow_l_per_min == -2.0 * s.flow_counts for s in samples)
    assert attached == TWO.text
    manifest = Manifest.of(metadata)
    assert (manifest.description_sha256, manifest.rehearsal) == (TWO.sha256, None)


def test_a_reading_that_the_rig_does_not_use_has_no_value(tmp_path: Path) -> None:
    samples, _, _ = _recorded(tmp_path, RC)

    assert all(isnan(s.unused_1) and s.unused_1_counts for s in samples)
    assert all(s.y_V == (s.y_counts - 5461.333) * 6 / 65536 for s in samples)


def test_a_recording_without_a_description_is_the_arms() -> None:
    assert description_of({}) is builtin("arm")
    assert description_of({DESCRIPTION: RC.text}) == RC


def test_the_configuration_names_the_file_of_the_description(tmp_path: Path) -> None:
    (tmp_path / "rc.toml").write_bytes(RC.text)
    (tmp_path / "armrig.toml").write_text('[rig]\nfile = "rc.toml"\n')

    config = load([tmp_path / "armrig.toml"], {}, {})

    assert configured(config) == RC
    assert configured(Config()) is builtin("arm")
    assert config.rules(RC).conversions == RC.conversions
    assert Config().rules().conversions == Config().calibration.channels


def test_the_description_of_a_shield_names_its_image_and_its_highest_voltage() -> None:
    def given(rig: str, **limits: float) -> tuple[float, int, Image | UnsetType]:
        config = load([], {}, {"rig": {"file": str(path_of(Path(rig)))}, "limits": limits})
        image = config.rules(configured(config)).image
        return config.limits.u_max_v, config.emulator.pwm_bits, image

    crcs = image_crcs()
    assert given("tclab") == (3.92, 8, Image("tclab", crcs["tclab"]))
    assert given("tclab", u_max_v=1.0)[0] == 1.0
    assert given("heater") == (5.0, 10, Image("uno", 0, tuple(crcs.values())[1:]))
    assert given("arm") == (5.0, 10, UNSET)


def test_the_description_of_an_arm_is_its_calibration(tmp_path: Path) -> None:
    text = builtin("arm").text.replace(b"zero_counts = 32768.0", b"zero_counts = 30000.0")
    (tmp_path / "arm.toml").write_bytes(text)
    file = {"rig": {"file": str(tmp_path / "arm.toml")}}

    assert load([], {}, file).calibration.alpha.zero_counts == 30_000
    measured = {"calibration": {"alpha": {"zero_counts": 31_000}}}
    assert load([], {}, file | measured).calibration.alpha.zero_counts == 31_000


@pytest.mark.parametrize(
    ("text", "error"),
    [(None, r"heater.toml: No such file"), ("[rig]\n", r"\[rig\] or \[outputs\] is missing")],
)
def test_a_bad_description_prevents_the_start(tmp_path: Path, text: str | None, error: str) -> None:
    path = tmp_path / "heater.toml"
    if text is not None:
        path.write_text(text)

    with pytest.raises(ValueError, match=rf"\[rig\] file: .*{error}"):
        load([], {}, {"rig": {"file": str(path)}})
