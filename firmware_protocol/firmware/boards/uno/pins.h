// The pins of the Uno, by their numbers on its board (docs/hardware.md has the drawing).
#ifndef PINS_H
#define PINS_H

#include <avr/io.h>

#define PWM_PIN _BV(PB1) // D9, OC1A: the motor's PWM, 15.6 kHz
#define ENABLE_PIN _BV(PD7) // D7: the driver's enable line. Not D13, which the boot loader toggles;
                            // not on port B, which the code writes while the PWM runs.
enum { THETA_1_CHANNEL = 0, ALPHA_CHANNEL = 1, OPEN_CHANNEL = 5 }; // A0, A1, A5

#endif
