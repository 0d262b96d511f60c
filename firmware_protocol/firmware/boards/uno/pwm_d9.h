// PWM on D9 (PB1, OC1A) by timer 1: 10 bits, 15.6 kHz.
#ifndef PWM_D9_H
#define PWM_D9_H

#include <avr/io.h>

#define PWM_BITS 10
#define PWM_PIN _BV(PB1)
#define PWM_PORT PORTB
#define PWM_DDR DDRB
#define PWM_MODE TCCR1A
#define PWM_CLOCK TCCR1B
#define PWM_COMPARE OCR1A
#define PWM_COUNTER TCNT1

// Mode 7: fast PWM, 10 bits. On silicon, mode 14 would also be correct, but simavr 1.6 models it
// wrongly.
#define DISCONNECTED (_BV(WGM11) | _BV(WGM10))
#define CONNECTED (DISCONNECTED | _BV(COM1A1))
#define NORMAL_MODE _BV(COM1A1)
#define COUNTS (_BV(WGM12) | _BV(CS10))
#define FORCE_MATCH() (TCCR1C = _BV(FOC1A))

enum { LAST_COUNTS = 1023 - 7 }; // half a microsecond before the end of a period

#endif
