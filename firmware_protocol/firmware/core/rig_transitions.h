// The requests that lead from state to state (PROTOCOL.md, sections 3 and 4).
#ifndef RIG_TRANSITIONS_H
#define RIG_TRANSITIONS_H

#include "rig_frame.h"

// Takes a configuration, or says why not.
void rig_take_config(const rig_config_t *m);

// Binds the device to the host that knows this boot, this configuration and its nonce.
void rig_take_arm(const union rig_message *m);

// Lets the motor have u_rest, and in scheduled mode the timer run.
void rig_take_start(const union rig_message *m);

// Ends what is going on.
void rig_take_stop(const union rig_message *m);

// Leaves FAULT or ESTOP, for who knows the token.
void rig_take_clear_fault(const union rig_message *m);

// Latches 0 V.
void rig_take_estop(const union rig_message *m);

#endif
