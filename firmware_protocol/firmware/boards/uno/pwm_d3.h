// PWM on D3 (PD3, OC2B) by timer 2: 8 bits, 7.8 kHz.
//
// The clock is 16 MHz / 8. With a period of 128 us, u acts well within the shortest Ts. A faster PWM
// would distort the mean, because a heater's bipolar transistor turns off a microsecond late.
#ifndef PWM_D3_H
#define PWM_D3_H

#include <avr/io.h>

#define PWM_BITS 8
#define PWM_PIN _BV(PD3)
#define PWM_PORT PORTD
#define PWM_DDR DDRD
#define PWM_MODE TCCR2A
#define PWM_CLOCK TCCR2B
#define PWM_COMPARE OCR2B
#define PWM_COUNTER TCNT2

// Mode 3: fast PWM, 8 bits.
#define DISCONNECTED (_BV(WGM21) | _BV(WGM20))
#define CONNECTED (DISCONNECTED | _BV(COM2B1))
#define NORMAL_MODE _BV(COM2B1)
#define COUNTS _BV(CS21)
#define FORCE_MATCH() (TCCR2B = _BV(FOC2B)) // the timer is stopped, and remains so

enum { LAST_COUNTS = 255 }; // at most half a microsecond before the end of a period

#endif
