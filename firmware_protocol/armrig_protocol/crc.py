"""CRC-32/ISO-HDLC, the frame check."""

from __future__ import annotations

from zlib import crc32

__all__ = ["CHECK", "crc32"]

CHECK = 0xCBF43926  # crc32(b"123456789"), the check value in the catalogue of CRC algorithms
