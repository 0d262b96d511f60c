// The supply: measured every 100 ms, and a guard where it is low (PROTOCOL.md, section 7).
// `rig_supply` is in board.h.
#ifndef RIG_SUPPLY_H
#define RIG_SUPPLY_H

#include <stdbool.h>
#include <stdint.h>

// Asks for the first measurement.
void rig_supply_begin(void);

// Returns the supply as measured last, in mV; 0 where it is not.
uint16_t rig_supply_mv(void);

// Returns whether it was too low when it was measured last.
bool rig_supply_is_low(void);

// Asks for a measurement where it is due, and trips where one was too low in ARMED or RUN.
void rig_watch_supply(void);

#endif
