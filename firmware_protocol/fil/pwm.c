// SPDX-License-Identifier: GPL-3.0-or-later
// The PWM on pin D9 (PB1, OC1A), measured at the pin: how long it is high in each period.
//
// simavr 1.6 lets a new OCR1A act in the middle of a period and holds the pin low where it is TOP.
// Silicon takes it over at the end of the period, and TOP is always high; both are put right here.
#include <avr_ioport.h>
#include <avr_timer.h>
#include <sim_interrupts.h>
#include "fil.h"

enum { OCR1AL = 0x88, OCR1AH = 0x89, TCCR1A = 0x80, PORTD = 0x2b, DDRD = 0x2a };
enum { COM1A1 = 0x80, ENABLE_BIT = 0x80, TIMER1_OVF = 13, TOP = FIL_PWM_PERIOD - 1 };

static avr_t *the_avr;
static avr_timer_comp_t *comp;
static avr_irq_t *pin_irq;
static uint8_t temp; // the high byte on its way: silicon's TEMP
static uint16_t ocr_buffer;
static int pin, enable;
static cycles_t rose, period_began;
static uint32_t high; // cycles of this period in which the pin was high, up to its last fall
static uint32_t told = UINT32_MAX;

// The duty of the period that ends, where it differs from that of the one before.
static void end_period(cycles_t when) {
    if (pin) {
        high += (uint32_t)(when - rose);
        rose = when;
    }
    uint32_t value = high | (uint32_t)enable << 16;
    if (value != told)
        tell(TOLD_VOLTS, period_began, value);
    told = value;
    high = 0;
    period_began = when;
}

static void judge(cycles_t when) {
    if (pin)
        figures.last_high = when;
    if (pin && !enable)
        tell(TOLD_VIOLATION, when, PIN_HIGH_WITHOUT_ENABLE);
}

// simavr is up to an instruction late; an edge that the timer makes is at the timer's own cycle.
static cycles_t edge_cycle(int level) {
    cycles_t began = comp->timer->tov_base, edge = level ? began : began + comp->comp_cycles;
    return the_avr->cycle - edge < 8 ? edge : the_avr->cycle;
}

static void pin_changed(avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq, (void)param;
    int level = value & 1;
    if (level == pin)
        return;
    cycles_t when = edge_cycle(level);
    if (pin)
        figures.last_high = when;
    pin = level;
    figures.edges++;
    if (level)
        rose = when;
    else
        high += (uint32_t)(when - rose);
    judge(when);
}

static void enable_changed(avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq, (void)param;
    enable = value & 1;
    judge(the_avr->cycle);
}

// At the end of each period the buffered OCR1A is taken over.
static void overflowed(avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq, (void)param;
    if (!value)
        return;
    avr_timer_t *timer = comp->timer;
    cycles_t when = timer->tov_base + timer->tov_cycles;
    end_period(when);
    judge(when);
    the_avr->data[OCR1AL] = (uint8_t)ocr_buffer;
    the_avr->data[OCR1AH] = (uint8_t)(ocr_buffer >> 8);
    comp->comp_cycles = ocr_buffer < TOP ? ocr_buffer + 1U : 0;
    if (!comp->comp_cycles && the_avr->data[TCCR1A] & COM1A1) {
        timer->tov_base = when; // as it will be; the edge is at the period's begin
        avr_raise_irq(pin_irq, 1);
    }
}

// Does not act before the low byte comes, whatever the timer does meanwhile.
static void write_high(avr_t *avr, avr_io_addr_t addr, uint8_t v, void *param) {
    (void)avr, (void)addr, (void)param;
    temp = v;
}

static void write_ocr(avr_t *avr, avr_io_addr_t addr, uint8_t v, void *param) {
    (void)addr, (void)param;
    uint16_t active = comp->timer->tov_cycles ? (uint16_t)(comp->comp_cycles ? comp->comp_cycles - 1 : TOP) : 0;
    ocr_buffer = (uint16_t)(temp << 8 | v);
    if (!comp->timer->tov_cycles) { // a timer that stands takes it at once
        avr->data[OCR1AL] = v;
        avr->data[OCR1AH] = temp;
        return;
    }
    avr->data[OCR1AL] = (uint8_t)active;
    avr->data[OCR1AH] = (uint8_t)(active >> 8);
}

// All pins are inputs after a reset, and pulled down from outside.
void pwm_reset(avr_t *avr) {
    if (pin)
        high += (uint32_t)(avr->cycle - rose);
    pin = enable = 0;
    ocr_buffer = 0;
    end_period(avr->cycle);
}

// Watch the pins, and put our handler in the place of simavr's.
void pwm_attach(avr_t *avr) {
    the_avr = avr;
    comp = avr->io[AVR_DATA_TO_IO(OCR1AL)].w.param;
    avr->io[AVR_DATA_TO_IO(OCR1AL)].w.c = write_ocr;
    avr->io[AVR_DATA_TO_IO(OCR1AH)].w.c = write_high;
    pin_irq = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('B'), 1);
    avr_irq_register_notify(pin_irq, pin_changed, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), 7), enable_changed, NULL);
    avr_irq_register_notify(avr_get_interrupt_irq(avr, TIMER1_OVF) + AVR_INT_IRQ_PENDING, overflowed, NULL);
}
