"""A sample's bytes are plain protobuf, and lie at constant places."""

from __future__ import annotations

import math

import pytest
from armrig_core.telemetry import protobuf, telemetry
from armrig_core.telemetry.channels import SAMPLE_FIELDS, SAMPLE_NAMES
from armrig_core.telemetry.telemetry import Sample, decode_sample, encode_sample
from google.protobuf import descriptor_pb2
from google.protobuf.descriptor import FieldDescriptor
from hypothesis import given
from hypothesis import strategies as st

_KINDS = {
    "fixed64": st.integers(0, 2**64 - 1),
    "sfixed64": st.integers(-(2**63), 2**63 - 1),
    "double": st.floats(allow_nan=False),
    "fixed32": st.integers(0, 2**32 - 1),
}
_IMPOSSIBLE = {
    FieldDescriptor.TYPE_DOUBLE: math.nan,
    FieldDescriptor.TYPE_FIXED32: 2**32 - 1,
    FieldDescriptor.TYPE_FIXED64: 2**64 - 1,
    FieldDescriptor.TYPE_SFIXED32: -1,
    FieldDescriptor.TYPE_SFIXED64: -1,
}
samples = st.builds(Sample, *(_KINDS[kind] for _, kind in SAMPLE_FIELDS))


@given(samples)
def test_a_packed_sample_equals_the_encoding_of_protobuf(sample: Sample) -> None:
    message = protobuf.message_class(protobuf.SAMPLE)(
        **dict(zip(SAMPLE_NAMES, sample, strict=True))
    )

    assert message.SerializeToString(deterministic=True) == encode_sample(sample)
    assert len(encode_sample(sample)) == telemetry.SAMPLE_LENGTH == 87
    assert decode_sample(encode_sample(sample)) == sample


def test_an_unknown_angle_is_encoded_as_nan() -> None:
    """At a rail there is no angle."""
    sample = Sample(*(0 for _ in SAMPLE_FIELDS))._replace(value_0=math.nan)

    decoded = decode_sample(encode_sample(sample))

    assert decoded is not None
    assert math.isnan(decoded.value_0)


@pytest.mark.parametrize("name", sorted({*protobuf.OF_STREAM.values()} - {protobuf.LOG}))
def test_a_number_missing_in_a_message_is_unknown(name: str) -> None:
    """In a message of an older writer an appended field is absent, and 0 rad would be an angle."""
    numbers = {
        field.name: (field.type, getattr(protobuf.decode_message(name, b""), field.name))
        for field in protobuf.message_class(name).DESCRIPTOR.fields
        if field.type in _IMPOSSIBLE
    }

    assert numbers
    for field, (kind, value) in numbers.items():
        assert value == _IMPOSSIBLE[kind] or math.isnan(value), field


@given(samples)
def test_a_number_in_a_message_is_read_unchanged(sample: Sample) -> None:
    message = protobuf.decode_message(protobuf.SAMPLE, encode_sample(sample))

    assert tuple(getattr(message, name) for name, _ in SAMPLE_FIELDS) == sample


def test_a_message_of_another_layout_is_not_decoded_as_a_sample() -> None:
    data = encode_sample(Sample(*(0 for _ in SAMPLE_FIELDS)))

    assert decode_sample(data + b"\x60\x00") is None
    assert decode_sample(b"\x11" + data[1:]) is None


def test_the_served_schemas_are_self_contained() -> None:
    for name in (protobuf.SAMPLE, protobuf.GAP, protobuf.TIMING, protobuf.STATE, protobuf.LOG):
        files = descriptor_pb2.FileDescriptorSet.FromString(protobuf.descriptor_set(name)).file

        defined = {f"{file.package}.{m.name}" for file in files for m in file.message_type}
        assert name in defined
        assert {d for file in files for d in file.dependency} <= {file.name for file in files}
