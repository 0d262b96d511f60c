// SPDX-License-Identifier: GPL-3.0-or-later
// The converter. Timer 0 triggers it (simavr 1.6 has no such trigger), and it holds its input when
// silicon does. The host supplies each reading from its model of the arm and the potentiometers.
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
    // simavr computes the code from millivolts, and reads the multiplexer only when the code is
    // read. By then the firmware may have set another channel. All inputs therefore get the lowest
    // voltage that results in this code.
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
        return; // the bandgap, which simavr models itself
    channel = what.mux.src;
    uint32_t clock = 1U << ((the_avr->data[ADCSRA] & 7U) ? (the_avr->data[ADCSRA] & 7U) : 1U);
    // Data sheet, table 24-1: the input is held 2 ADC clocks after the timer's trigger, and 3
    // cycles more for the synchronisation. If the program starts the conversion, the input is held
    // after 1.5 clocks.
    avr_cycle_timer_register(the_avr, by_timer ? 2 * clock + 3 : clock * 3 / 2, held, NULL);
}

// The trigger is the rising edge of the flag. If the program does not clear the flag, there is no
// further trigger.
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

// Make the converter ignore the timer's triggers, or obey them again.
void adc_stand(int is_to) {
    stands = is_to;
}

// Set the supply voltage, against which the bandgap is measured.
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
