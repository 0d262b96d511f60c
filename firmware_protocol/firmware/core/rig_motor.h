// The motor. Only this module drives the motor; every module may turn it off.
#ifndef RIG_MOTOR_H
#define RIG_MOTOR_H

#include <stdint.h>

// Returns the duty nearest to a code, in steps for board_motor_set. No code is midway between two
// duties.
uint16_t rig_duty(uint16_t code);

// Returns the code nearest to a duty; a tie is rounded up.
uint16_t rig_code(uint16_t duty);

// Turns the motor off. The motor stays at 0 V until `rig_motor_begin`. Called from both contexts.
void rig_motor_cut(void);

// Permits driving the motor, and applies u_rest. Called from main when RUN has just begun.
void rig_motor_begin(uint16_t u_seq);

// Applies a code if the motor may be driven. Called from an interrupt.
void rig_motor_latch(uint16_t u, uint16_t u_seq);

#endif
