// The supply: measured every 100 ms, and guarded against a low voltage (PROTOCOL.md, section 7).
// board.h declares `rig_supply`.
#ifndef RIG_SUPPLY_H
#define RIG_SUPPLY_H

#include <stdbool.h>
#include <stdint.h>

// Requests the first measurement.
void rig_supply_begin(void);

// Returns the last measured supply, in mV, or 0 if the supply was never measured.
uint16_t rig_supply_mv(void);

// Returns true if the last measured supply was too low.
bool rig_supply_is_low(void);

// Requests a measurement if a measurement is due. In ARMED and RUN, trips if the measured supply is
// too low.
void rig_watch_supply(void);

#endif
