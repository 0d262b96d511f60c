#include "rig_crc.h"

#include "rig_flash.h" // RIG_FLASH

// CRC of each nibble, polynomial EDB88320 (reflected).
static const RIG_FLASH uint32_t OF_NIBBLE[16] = {
    0x00000000, 0x1DB71064, 0x3B6E20C8, 0x26D930AC, 0x76DC4190, 0x6B6B51F4, 0x4DB26158, 0x5005713C,
    0xEDB88320, 0xF00F9344, 0xD6D6A3E8, 0xCB61B38C, 0x9B64C2B0, 0x86D3D2D4, 0xA00AE278, 0xBDBDF21C,
};

uint32_t rig_crc(const uint8_t *bytes, uint8_t n)
{
    return rig_crc_further(0, bytes, n);
}

uint32_t rig_crc_further(uint32_t crc, const uint8_t *bytes, uint8_t n)
{
    crc = ~crc;
    for (; n; n--, bytes++) {
        crc = crc >> 4 ^ OF_NIBBLE[((uint8_t)crc ^ *bytes) & 0xF];
        crc = crc >> 4 ^ OF_NIBBLE[((uint8_t)crc ^ *bytes >> 4) & 0xF];
    }
    return ~crc;
}
