// The supply, measured by the bandgap in the gaps between samples.
#ifndef SUPPLY_H
#define SUPPLY_H

#include <stdbool.h>
#include <stdint.h>

// A sample has ended: now is when to begin, so that none waits for it. From an interrupt.
void supply_offer(void);

// Once a turn or less often; `free_turns` is for how many more the converter is not needed.
// Interrupts are off.
void supply_turn(uint8_t free_turns);

// The converter is needed for a sample; false where it is busy with the supply until `supply_end`.
bool supply_yields(void);

bool supply_is_at_rest(void);

// Takes a reading; returns whether it was the supply's. From an interrupt.
bool supply_end(uint16_t reading);

#endif
