// SPDX-License-Identifier: GPL-3.0-or-later
// The converter: triggered by timer 0 (simavr 1.6 has no such trigger), held when silicon holds,
// and read by the host, who has the arm and its potentiometers.
#include <avr_adc.h>
#include <sim_cycle_timers.h>
#include <sim_interrupts.h>
#include "fil.h"

enum { ADCSRA = 0x7a, ADCSRB = 0x7b, ADATE = 0x20, ADEN = 0x80, ADTS = 7, ADTS_TIMER0_COMPA = 3, TIMER0_COMPA = 14 };

static avr_t *the_avr;
static avr_irq_t *inputs, *trigger;
static int flag, by_timer, stands;
static unsigned channel;

static cycles_t held(avr_t *avr, cycles_t when, void *param) {
    (void)param;
    uint32_t code = ask_conversion(when, (uint8_t)channel);
    // simavr makes a code of millivolts, and asks the multiplexer when the code is read, which the
    // firmware may have turned on: so the least voltage that gives this code, on every input.
    uint32_t millivolts = (code * avr->avcc + 1022U) / 1023U;
    for (int i = 0; i < 8; i++)
        avr_raise_irq(inputs + i, millivolts);
    return 0;
}

static void conversion_began(avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq, (void)param;
    union {
        avr_adc_mux_t mux;
        uint32_t value;
    } what = {.value = value};
    if (what.mux.kind != ADC_MUX_SINGLE)
        return; // the bandgap: simavr knows it
    channel = what.mux.src;
    uint32_t clock = 1U << ((the_avr->data[ADCSRA] & 7U) ? (the_avr->data[ADCSRA] & 7U) : 1U);
    // Data sheet, table 24-1: held 2 clocks after the timer's trigger, and 3 cycles to synchronise;
    // 1.5 clocks after the beginning of one that the program began.
    avr_cycle_timer_register(the_avr, by_timer ? 2 * clock + 3 : clock * 3 / 2, held, NULL);
}

// The trigger is the rising edge of the flag: one that was never cleared triggers no more.
static void compared(avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq, (void)param;
    int rises = value && !flag;
    flag = value != 0;
    if (rises && !stands && the_avr->data[ADCSRA] & ADATE && (the_avr->data[ADCSRB] & ADTS) == ADTS_TIMER0_COMPA) {
        by_timer = 1;
        avr_raise_irq(trigger, 1);
        by_timer = 0;
    }
}

// From now on no trigger of the timer begins a conversion, or each does again.
void adc_stand(int is_to) {
    stands = is_to;
}

// Let the supply be this; the bandgap is read against it.
void adc_supply(avr_t *avr, uint16_t millivolts) {
    avr->vcc = avr->avcc = avr->aref = millivolts;
}

void adc_attach(avr_t *avr) {
    the_avr = avr;
    inputs = avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_ADC0);
    trigger = avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_IN_TRIGGER);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_OUT_TRIGGER), conversion_began, NULL);
    avr_irq_register_notify(avr_get_interrupt_irq(avr, TIMER0_COMPA) + AVR_INT_IRQ_PENDING, compared, NULL);
    adc_supply(avr, 5000);
}
