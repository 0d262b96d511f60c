// CRC-32/ISO-HDLC, the frame check: that of zlib and gzip.
#ifndef RIG_CRC_H
#define RIG_CRC_H

#include <stdint.h>

// Returns the CRC-32 of `n` bytes.
uint32_t rig_crc(const uint8_t *bytes, uint8_t n);

// Returns the CRC-32 of bytes whose is `crc` and `n` more; 0 is that of none.
uint32_t rig_crc_further(uint32_t crc, const uint8_t *bytes, uint8_t n);

#endif
