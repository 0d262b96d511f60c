#include "rig_cobs.h"

void rig_stuff(uint8_t *bytes, uint8_t n)
{
    uint8_t code = 1; // distance from `at` to the next 00, or to the end
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
