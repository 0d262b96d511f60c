// The requests that change the state (PROTOCOL.md, sections 3 and 4).
#ifndef RIG_TRANSITIONS_H
#define RIG_TRANSITIONS_H

#include "rig_frame.h"

// Accepts a configuration, or refuses it with a code in CONFIG_R.
void rig_take_config(const rig_config_t *m);

// Enters ARMED if the host names this boot, the configuration in force and its nonce.
void rig_take_arm(const union rig_message *m);

// Enters RUN: u_rest is applied, and in scheduled mode the timer starts.
void rig_take_start(const union rig_message *m);

// Returns to IDLE from every state except FAULT and ESTOP.
void rig_take_stop(const union rig_message *m);

// Leaves FAULT or ESTOP for IDLE if the host sends the right token.
void rig_take_clear_fault(const union rig_message *m);

// Enters ESTOP: the motor stays at 0 V until CLEAR_FAULT.
void rig_take_estop(const union rig_message *m);

#endif
