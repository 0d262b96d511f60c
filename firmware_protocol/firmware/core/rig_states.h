// The states and the way from one to the other (PROTOCOL.md, section 3).
#ifndef RIG_STATES_H
#define RIG_STATES_H

#include <stdbool.h>
#include <stdint.h>

// Makes a transition; into every state but RUN with the motor off before anything else. From main.
void rig_enter(uint8_t state, uint8_t cause, uint32_t detail);

// Tells the last transition by its EVENT.
void rig_tell_transition(void);

// ARMED or RUN: bound to a host, watchdog on.
bool rig_is_bound(void);

// RUN of scheduled mode: the timer makes the samples.
bool rig_is_timed(void);

// Trips where the host has been silent for too long, or the last input was held, or a check failed.
void rig_watch_run(void);

#endif
