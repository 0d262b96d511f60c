// The states and their transitions (PROTOCOL.md, section 3).
#ifndef RIG_STATES_H
#define RIG_STATES_H

#include <stdbool.h>
#include <stdint.h>

// Makes a transition. For every state but RUN, first turns the motor off. Called from main.
void rig_enter(uint8_t state, uint8_t cause, uint32_t detail);

// Sends the EVENT of the latest transition.
void rig_tell_transition(void);

// Returns true in ARMED and RUN: the device is bound to a host, and the watchdog is on.
bool rig_is_bound(void);

// Returns true in RUN of scheduled mode: the device's timer paces the samples.
bool rig_is_timed(void);

// Trips if the host was silent for too long, or the last check before the pin found a wrong code.
void rig_watch_run(void);

#endif
