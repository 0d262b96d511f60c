// CAL: statistics of the readings of one channel (PROTOCOL.md, section 5).
#ifndef RIG_CAL_H
#define RIG_CAL_H

#include <stdbool.h>
#include <stdint.h>

#include "rig_frame.h"

// State of a CAL. The interrupt owns the statistics while `left` is not 0; otherwise main owns
// them.
struct rig_cal {
    uint64_t squares;
    uint32_t sum;
    uint16_t n, least, greatest;
    volatile uint16_t left; // conversions still to come
    volatile bool is_under_way; // from CAL until CAL_R; written by main
    uint8_t channel;
};

// Executes CAL: starts the conversions, or refuses the request.
void rig_take_cal(const union rig_message *m);

// Adds a reading to the statistics. Called from an interrupt.
void rig_cal_add(uint16_t code);

// Sends CAL_R if the last conversion of a CAL has ended.
void rig_tell_cal(void);

#endif
