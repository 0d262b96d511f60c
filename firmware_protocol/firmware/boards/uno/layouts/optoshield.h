// OptoShield: the light-emitting diode on D3, the photoresistor on A1.
#include "../pwm_d3.h"

#define ENABLE_PIN 0
#define REFERENCE SUPPLY_AS_REFERENCE
#define ONE_ANALOGUE_PIN
enum { THETA_1_CHANNEL = 1 };
