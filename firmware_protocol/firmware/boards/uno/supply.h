// The supply, measured between samples by the bandgap reference.
#ifndef SUPPLY_H
#define SUPPLY_H

#include <stdbool.h>
#include <stdint.h>

// Reports that a sample has ended, so that a wanted measurement begins now and delays no sample.
// Called from an interrupt.
void supply_offer(void);

// Advances the measurement. For `free_turns` more turns, no sample needs the converter. Called once
// a turn or less often, with interrupts off.
void supply_turn(uint8_t free_turns);

// Requests the converter for a sample. Returns false if the converter is converting the supply, and
// is not free before `supply_end`.
bool supply_yields(void);

bool supply_is_at_rest(void);

// Processes a reading. Returns true if the reading was of the supply. Called from an interrupt.
bool supply_end(uint16_t reading);

#endif
