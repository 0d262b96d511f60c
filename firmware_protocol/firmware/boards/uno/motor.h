// The motor's pins; the rest is in core/board.h.
#ifndef MOTOR_H
#define MOTOR_H

#include <stdbool.h>

void motor_begin(void);

// While it is on, what is set waits for `motor_apply`; board_motor_off makes that void. From an
// interrupt, whose own it is.
void motor_stage(bool on);
void motor_apply(void);

#endif
