// SPDX-License-Identifier: GPL-3.0-or-later
// simavr 1.6 differs from silicon in two points, which this file corrects for timer 0:
// - A write to one bit of TIFR clears every flag of the timer.
// - If an interrupt is enabled while its flag is set, the interrupt does not fire.
#include <avr_timer.h>
#include <sim_interrupts.h>
#include "fil.h"

enum { TIFR0_ADDRESS = 0x35, TIMSK0_ADDRESS = 0x6e };
enum { TIMER0_COMPA = 14, TIMER0_COMPB = 15, TIMER0_OVF = 16 };

// Numbers of the interrupts, in the order of their bits in TIFR0 and TIMSK0.
static const uint8_t numbers[] = {TIMER0_OVF, TIMER0_COMPA, TIMER0_COMPB};

// Return the interrupt vector with this number.
avr_int_vector_t *vector_of(avr_t *avr, uint8_t number) {
    for (int i = 0; i < avr->interrupts.vector_count; i++)
        if (avr->interrupts.vector[i]->vector == number)
            return avr->interrupts.vector[i];
    return NULL;
}

static void write_tifr(avr_t *avr, avr_io_addr_t addr, uint8_t v, void *param) {
    (void)addr, (void)param;
    for (unsigned bit = 0; bit < sizeof numbers; bit++)
        if (v & 1U << bit)
            avr_clear_interrupt(avr, vector_of(avr, numbers[bit]));
}

static void write_timsk(avr_t *avr, avr_io_addr_t addr, uint8_t v, void *param) {
    (void)param;
    uint8_t raised = avr->data[TIFR0_ADDRESS] & v & ~avr->data[addr];
    avr->data[addr] = v;
    for (unsigned bit = 0; bit < sizeof numbers; bit++)
        if (raised & 1U << bit)
            avr_raise_interrupt(avr, vector_of(avr, numbers[bit]));
}

// Replace simavr's handlers.
void flags_attach(avr_t *avr) {
    avr->io[AVR_DATA_TO_IO(TIFR0_ADDRESS)].w.c = write_tifr;
    avr->io[AVR_DATA_TO_IO(TIFR0_ADDRESS)].w.param = NULL;
    avr_register_io_write(avr, TIMSK0_ADDRESS, write_timsk, NULL);
}
