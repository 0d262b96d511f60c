// Consistent overhead byte stuffing (Cheshire and Baker 1999), in place.
#ifndef RIG_COBS_H
#define RIG_COBS_H

#include <stdbool.h>
#include <stdint.h>

// Stuffs bytes[1] ... bytes[n - 1], n at most 254; bytes[0] is the place for the byte of overhead.
void rig_stuff(uint8_t *bytes, uint8_t n);

// Undoes it for `n` bytes that have no 00; returns whether no code points behind the end.
bool rig_unstuff(uint8_t *bytes, uint8_t n);

#endif
