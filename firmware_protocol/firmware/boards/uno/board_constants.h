// The constants of an Arduino Uno: ATmega328P, 16 MHz, 5 V (core/board.h explains each constant).
#ifndef BOARD_CONSTANTS_H
#define BOARD_CONSTANTS_H

#include <avr/interrupt.h>
#include <avr/io.h>
#include <stdint.h>

#include "pins.h"

#define BOARD_QUEUE 256 // 2 B each; 256 ms at 1 kHz, of which the host keeps 232 ms in reserve
#define BOARD_ADC_BITS 10
#define BOARD_PWM_BITS PWM_BITS
#define BOARD_SKEW_US 128 // one turn of timer 0: see clock.h and converter.c
#define BOARD_HOLD_US 16 // data sheet, table 24-1: two clocks of 125 kHz after the trigger
#define BOARD_TS_MIN_US 800 // also at 1 Mbaud: see converter.c
#define BOARD_CAPABILITIES \
    (RIG_CAPABILITY_EXCHANGE | RIG_CAPABILITY_SCHEDULED | RIG_CAPABILITY_CAL \
        | (ENABLE_PIN ? RIG_CAPABILITY_ENABLE_LINE : 0))
#define BOARD_RAM 1100

// Turn interrupts off; restore their previous state. A write to SREG and cli are no barriers to the
// compiler.
#define BOARD_IRQ_INLINE
static inline uint8_t board_irq_save(void)
{
    const uint8_t before = SREG;
    __asm__ volatile("cli" ::: "memory");
    return before;
}

static inline void board_irq_restore(uint8_t before)
{
    __asm__ volatile("" ::: "memory");
    SREG = before;
}

#endif
