// Temperature Control Lab: heater 1 on D3, thermometers on A0 and A2, 3.3 V on AREF.
#include "../pwm_d3.h"

#define ENABLE_PIN 0
#define REFERENCE AREF_AS_REFERENCE
enum { THETA_1_CHANNEL = 0, ALPHA_CHANNEL = 2 };
