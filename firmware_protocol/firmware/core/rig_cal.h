// CAL: readings of one channel, and what they come to (PROTOCOL.md, section 5).
#ifndef RIG_CAL_H
#define RIG_CAL_H

#include <stdbool.h>
#include <stdint.h>

#include "rig_frame.h"

// The readings under way: main's while none is, the interrupt's until all have come.
struct rig_cal {
    uint64_t squares;
    uint32_t sum;
    uint16_t n, least, greatest;
    volatile uint16_t left; // conversions to come
    volatile bool is_under_way; // until main has told it
    uint8_t channel;
};

// Gives the converter to CAL.
void rig_take_cal(const union rig_message *m);

// Adds a reading. From an interrupt.
void rig_cal_add(uint16_t code);

// Sends CAL_R where the last conversion has ended.
void rig_tell_cal(void);

#endif
