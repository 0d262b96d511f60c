// Guards over the readings in RUN: long on a rail, too many turns (PROTOCOL.md, section 7).
#ifndef RIG_GUARDS_H
#define RIG_GUARDS_H

#include <stdbool.h>
#include <stdint.h>

// What was seen since START. Owned by main.
struct rig_guards {
    uint16_t rails[2]; // samples in a row at a rail, of theta_1 and of alpha
    int32_t turned; // way of theta_1, in codes
    uint16_t y0; // last reading of theta_1
    bool has_y0;
};

// Returns whether a reading is in the lowest or highest 1/1024 of the range.
bool rig_at_rail(uint16_t y);

// Takes note of a sample; returns the cause of a fault, or RIG_CAUSE_NONE. 0 is no limit.
uint8_t rig_watch(
    struct rig_guards *guards, uint16_t y0, uint16_t y1, uint16_t rail_ticks, uint16_t turns);

#endif
