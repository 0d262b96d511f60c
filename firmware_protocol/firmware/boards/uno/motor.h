// The motor's pins; the rest is in core/board.h.
#ifndef MOTOR_H
#define MOTOR_H

void motor_begin(void);

#endif
