// The device's clock. Timer 0 counts half microseconds, and its overflow interrupt counts turns. A
// turn is one cycle of timer 0, from overflow to overflow: 128 us.
#ifndef CLOCK_H
#define CLOCK_H

#include <stdint.h>

enum { TURN_US = 128 };

void clock_begin(void);

// Returns the number of turns since reset, modulo 256.
uint8_t clock_turns(void);

#endif
