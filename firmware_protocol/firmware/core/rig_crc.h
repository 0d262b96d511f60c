// CRC-32/ISO-HDLC, the frame check. zlib and gzip use the same CRC.
#ifndef RIG_CRC_H
#define RIG_CRC_H

#include <stdint.h>

// Returns the CRC-32 of `n` bytes.
uint32_t rig_crc(const uint8_t *bytes, uint8_t n);

// Continues a CRC-32 with `n` more bytes. `crc` is the CRC-32 of the bytes before them, or 0 if
// there are none.
uint32_t rig_crc_further(uint32_t crc, const uint8_t *bytes, uint8_t n);

#endif
