// The device's clock: timer 0 counts half microseconds, its interrupt the turns of 128 us.
#ifndef CLOCK_H
#define CLOCK_H

#include <stdint.h>

enum { TURN_US = 128 };

void clock_begin(void);

// Turns since reset, modulo 256.
uint8_t clock_turns(void);

#endif
