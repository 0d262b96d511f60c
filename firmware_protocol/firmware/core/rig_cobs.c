#include "rig_cobs.h"

void rig_stuff(uint8_t *bytes, uint8_t n)
{
    uint8_t code = 1; // from the last 00 behind `at` to the one before
    bytes[0] = 0;
    for (uint8_t at = n; at-- > 0; code++) {
        if (bytes[at] == 0) {
            bytes[at] = code;
            code = 0;
        }
    }
}

bool rig_unstuff(uint8_t *bytes, uint8_t n)
{
    uint8_t at = 0;
    while (at < n) {
        const uint8_t code = bytes[at];
        if (code > n - at)
            return false;
        bytes[at] = 0;
        at += code;
    }
    return true;
}
