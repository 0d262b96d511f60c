// Consistent overhead byte stuffing (Cheshire and Baker 1999), in place.
#ifndef RIG_COBS_H
#define RIG_COBS_H

#include <stdbool.h>
#include <stdint.h>

// Stuffs bytes[1] ... bytes[n - 1], and writes the overhead byte to bytes[0]; n is at most 254.
void rig_stuff(uint8_t *bytes, uint8_t n);

// Unstuffs `n` bytes that contain no 00. Returns false if a code byte points beyond the end.
bool rig_unstuff(uint8_t *bytes, uint8_t n);

#endif
