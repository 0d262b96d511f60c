// The guards on the readings in RUN: too long at a rail, too many turns (PROTOCOL.md, section 7).
#ifndef RIG_GUARDS_H
#define RIG_GUARDS_H

#include <stdbool.h>
#include <stdint.h>

// State of the guards since START. Owner: main.
struct rig_guards {
    uint16_t rails[2]; // successive samples at a rail, by channel
    int32_t turned; // net rotation of channel 0, in codes
    uint16_t y0; // previous reading of channel 0
    bool has_y0;
};

// Returns true if a reading is in the lowest or highest 1/1024 of the range.
bool rig_at_rail(uint16_t y);

// Checks a sample. Returns the cause of a fault, or RIG_CAUSE_NONE. A limit of 0 switches its guard
// off.
uint8_t rig_watch(
    struct rig_guards *guards, uint16_t y0, uint16_t y1, uint16_t rail_ticks, uint16_t turns);

#endif
