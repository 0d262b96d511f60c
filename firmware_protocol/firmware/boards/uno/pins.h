// The pins of the Uno, by their numbers on its board (docs/hardware.md has the drawing). A layout
// defines:
//   ENABLE_PIN                      enable line, on port D; 0 if there is none
//   REFERENCE                       reference of the converter
//   THETA_1_CHANNEL, ALPHA_CHANNEL  analogue pins; or ONE_ANALOGUE_PIN and THETA_1_CHANNEL
// It includes the header of its PWM pin.
#ifndef PINS_H
#define PINS_H

#include <avr/io.h>

#define SUPPLY_AS_REFERENCE _BV(REFS0)
// The pin AREF. If the shield drives this pin, the supply as reference would connect the two
// voltages (data sheet, 24.5.2): such a layout cannot measure the supply.
#define AREF_AS_REFERENCE 0

#include LAYOUT // the Makefile chooses a header of layouts/

enum { OPEN_CHANNEL = 5 }; // A5

// With one analogue pin, channel 1 is a second reading of this pin. Bit 4 is not part of the
// multiplexer's number; it tells the two readings apart.
#ifdef ONE_ANALOGUE_PIN
enum { ALPHA_CHANNEL = THETA_1_CHANNEL | 0x10 };
#define INPUT_OF(channel) ((channel) & 0x0F)
#else
#define INPUT_OF(channel) (channel)
#endif

#endif
