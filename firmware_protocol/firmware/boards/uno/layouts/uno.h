// The arm: theta_1 on A0, alpha on A1, the motor driver on D9 with its enable line on D7.
#include "../pwm_d9.h"

#define ENABLE_PIN _BV(PD7) // Not D13, which the boot loader toggles; not on port B, which the code
                            // writes while the PWM runs.
#define REFERENCE SUPPLY_AS_REFERENCE
enum { THETA_1_CHANNEL = 0, ALPHA_CHANNEL = 1 };
