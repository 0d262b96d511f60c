// The motor: the one place that drives it, and the way to 0 V.
#ifndef RIG_MOTOR_H
#define RIG_MOTOR_H

#include <stdint.h>

// Returns the steps of 2^BOARD_PWM_BITS that stand for a code, to the nearest; there are no ties.
uint16_t rig_duty(uint16_t code);

// Returns the code of what the pin really gives with a duty; a tie goes up.
uint16_t rig_code(uint16_t duty);

// 0 V, until `rig_motor_begin`. From both contexts.
void rig_motor_cut(void);

// Lets the motor have u_rest; RUN has just begun. From main.
void rig_motor_begin(uint16_t u_seq);

// Latches a code, where the motor may be driven at all. From an interrupt.
void rig_motor_latch(uint16_t u, uint16_t u_seq);

#endif
