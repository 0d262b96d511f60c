// The motor's pins. core/board.h declares the other functions of the motor.
#ifndef MOTOR_H
#define MOTOR_H

#include <stdbool.h>

void motor_begin(void);

// After motor_stage(true), board_motor_set only stores its duty. motor_apply applies the stored
// duty; board_motor_off discards it. Both functions are called from one interrupt handler only.
void motor_stage(bool on);
void motor_apply(void);

#endif
