// The CRC-32 of the program in flash, by which HELLO_R identifies the firmware.
#include <avr/pgmspace.h>
#include <stdint.h>

#include "board.h"
#include "rig_crc.h"

extern const uint8_t __data_load_end[]; // linker symbol: end of the program in flash

uint32_t board_firmware_crc(void)
{
    static uint32_t crc; // computed once per boot, because the computation is slow
    if (crc)
        return crc;
    uint8_t piece[64];
    const uint8_t *const end = __data_load_end;
    for (const uint8_t *at = 0; at < end; at += sizeof piece) {
        const uint8_t n = end - at < (int16_t)sizeof piece ? end - at : (int16_t)sizeof piece;
        memcpy_P(piece, at, n);
        crc = rig_crc_further(crc, piece, n);
    }
    return crc;
}
