"""A finished recording written once more, in chunks of a size that readers like.

While a run goes on a chunk ends at each flush, ten times a second: small, but safe. What is kept
has chunks of 1 MiB.
"""

from __future__ import annotations

import os
from pathlib import Path

from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

CHUNK = 1 << 20


def compact(source: Path, target: Path) -> None:
    """Write all that `source`, a complete recording, holds to `target`, and have it on the disk."""
    with source.open("rb") as read, target.open("xb") as written:
        writer = Writer(
            written, chunk_size=CHUNK, compression=CompressionType.ZSTD, enable_data_crcs=True
        )
        schemas, channels = {0: 0}, {}
        for record in StreamReader(read).records:
            match record:
                case Header():
                    writer.start(record.profile, record.library)
                case Schema() if record.id not in schemas:
                    number = writer.register_schema(record.name, record.encoding, record.data)
                    schemas[record.id] = number
                case Channel() if record.id not in channels:
                    channels[record.id] = writer.register_channel(
                        record.topic,
                        record.message_encoding,
                        schemas[record.schema_id],
                        record.metadata,
                    )
                case Message():
                    writer.add_message(
                        channels[record.channel_id],
                        record.log_time,
                        record.data,
                        record.publish_time,
                        record.sequence,
                    )
                case Metadata():
                    writer.add_metadata(record.name, record.metadata)
                case Attachment():
                    writer.add_attachment(
                        record.create_time,
                        record.log_time,
                        record.name,
                        record.media_type,
                        record.data,
                    )
        writer.finish()
        written.flush()
        os.fsync(written.fileno())
