// SPDX-License-Identifier: GPL-3.0-or-later
// Timer 1 and the PWM on pin D9 (PB1, OC1A). The duty is measured at the pin: the time for which
// the pin is high in each period.
//
// simavr's own timer 1 is not used, because it differs from silicon in three points:
// - A new OCR1A acts in the middle of a period.
// - The pin is low if OCR1A is TOP.
// - OC1A loses its level while the pin is disconnected.
//
// This file models the normal mode and mode 7 (fast PWM, 10 bits) as on silicon. OC1A is
// disconnected, or cleared on a match.
#include <avr_ioport.h>
#include <sim_cycle_timers.h>
#include "fil.h"

enum { TCCR1A = 0x80, TCCR1B = 0x81, TCCR1C = 0x82, TCNT1L = 0x84, TCNT1H = 0x85, OCR1AL = 0x88, OCR1AH = 0x89 };
enum { DDRB = 0x24, PORTB = 0x25, PWM_BIT = 0x02, ENABLE_BIT = 0x80 };
enum { COM1A1 = 0x80, WGM = 0x03, CS10 = 0x01, FOC1A = 0x80, TOP = FIL_PWM_PERIOD - 1 };

static avr_t *the_avr;
static avr_irq_t *pin_irq;
static uint8_t temp; // the high byte of a 16-bit write: silicon's TEMP register
static uint16_t ocr, ocr_buffer;
static int runs, oc1a; // 1 if the timer counts; the output level of the timer
static cycles_t bottom_at; // cycle at which the counter was 0, while the timer runs
static uint16_t stands_at; // value of the counter, while the timer is stopped
static int pin, enable;
static cycles_t edge_at; // cycle of the timer's edge: simavr is up to an instruction late
static cycles_t rose, period_began;
static uint32_t high; // cycles of this period with the pin high, up to its last fall
static uint32_t told = UINT32_MAX;

// Report the duty of the period that ends if it differs from that of the period before.
static void end_period(cycles_t when) {
    if (pin) {
        high += (uint32_t)(when - rose);
        rose = when;
    }
    if (high > FIL_PWM_PERIOD)
        high = FIL_PWM_PERIOD; // the pin was high before the timer was started
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

static void pin_changed(avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq, (void)param;
    int level = value & 1;
    if (level == pin)
        return;
    cycles_t when = edge_at ? edge_at : the_avr->cycle;
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

static int is_connected(void) {
    return the_avr->data[TCCR1A] & COM1A1;
}

// Set the pin to the level of the timer or of the port, at a cycle. An input is pulled down.
static void set_pin(cycles_t when) {
    int level = is_connected() ? oc1a : (the_avr->data[PORTB] & PWM_BIT) != 0;
    edge_at = when;
    avr_raise_irq(pin_irq, level && the_avr->data[DDRB] & PWM_BIT);
    edge_at = 0;
}

// Set the timer's output. While the pin is disconnected, OC1A keeps its level.
static void set_oc1a(cycles_t when, int level) {
    if (!is_connected())
        return;
    oc1a = level;
    set_pin(when);
}

static cycles_t match(avr_t *avr, cycles_t when, void *param) {
    (void)avr, (void)param;
    set_oc1a(when, 0);
    return 0;
}

static cycles_t bottom(avr_t *avr, cycles_t when, void *param) {
    (void)param;
    end_period(when);
    judge(when);
    bottom_at = when;
    ocr = ocr_buffer;
    set_oc1a(when, 1);
    if (ocr < TOP)
        avr_cycle_timer_register(avr, when + ocr + 1 - avr->cycle, match, NULL);
    return when + FIL_PWM_PERIOD;
}

static void stop(avr_t *avr) {
    if (runs)
        stands_at = (uint16_t)(avr->cycle - bottom_at);
    runs = 0;
    avr_cycle_timer_cancel(avr, match, NULL);
    avr_cycle_timer_cancel(avr, bottom, NULL);
}

static void go_on(avr_t *avr) {
    runs = 1;
    bottom_at = avr->cycle - stands_at;
    avr_cycle_timer_register(avr, (cycles_t)FIL_PWM_PERIOD - stands_at, bottom, NULL);
    if (stands_at <= ocr && ocr < TOP)
        avr_cycle_timer_register(avr, (cycles_t)ocr + 1 - stands_at, match, NULL);
}

static void write_tccra(avr_t *avr, avr_io_addr_t addr, uint8_t v, void *param) {
    (void)param;
    avr->data[addr] = v;
    set_pin(avr->cycle);
}

static void write_tccrb(avr_t *avr, avr_io_addr_t addr, uint8_t v, void *param) {
    (void)param;
    avr->data[addr] = v;
    stop(avr);
    if (v & CS10)
        go_on(avr);
}

// A forced match, which exists only in normal mode.
static void write_tccrc(avr_t *avr, avr_io_addr_t addr, uint8_t v, void *param) {
    (void)addr, (void)param;
    if (v & FOC1A && !(avr->data[TCCR1A] & WGM))
        set_oc1a(avr->cycle, 0);
}

// A high byte waits in TEMP until the low byte is written.
static void write_high(avr_t *avr, avr_io_addr_t addr, uint8_t v, void *param) {
    (void)avr, (void)addr, (void)param;
    temp = v;
}

static void write_tcnt(avr_t *avr, avr_io_addr_t addr, uint8_t v, void *param) {
    (void)addr, (void)param;
    int ran = runs;
    stop(avr);
    stands_at = (uint16_t)(temp << 8 | v) & TOP;
    if (ran)
        go_on(avr);
}

static uint8_t read_tcnt(avr_t *avr, avr_io_addr_t addr, void *param) {
    (void)param;
    uint16_t count = runs ? (uint16_t)(avr->cycle - bottom_at) & TOP : stands_at;
    avr->data[TCNT1H] = (uint8_t)(count >> 8);
    return avr->data[addr] = (uint8_t)count;
}

// In mode 7, a new OCR1A acts from the next period on.
static void write_ocr(avr_t *avr, avr_io_addr_t addr, uint8_t v, void *param) {
    (void)addr, (void)param;
    ocr_buffer = (uint16_t)(temp << 8 | v);
    if (!(avr->data[TCCR1A] & WGM))
        ocr = ocr_buffer;
}

// After a reset, all pins are inputs, and external resistors pull them down.
void pwm_reset(avr_t *avr) {
    if (pin)
        high += (uint32_t)(avr->cycle - rose);
    pin = enable = 0;
    stop(avr);
    ocr = ocr_buffer = stands_at = 0;
    oc1a = 0;
    end_period(avr->cycle);
    end_period(avr->cycle); // report the low level: no period ends before the timer is started
}

// Watch the pins, and replace simavr's timer 1.
void pwm_attach(avr_t *avr) {
    static const struct {
        uint16_t address;
        avr_io_write_t write;
    } registers[] = {
        {TCCR1A, write_tccra}, {TCCR1B, write_tccrb}, {TCCR1C, write_tccrc}, {TCNT1L, write_tcnt},
        {TCNT1H, write_high}, {OCR1AL, write_ocr}, {OCR1AH, write_high},
    };
    the_avr = avr;
    for (size_t i = 0; i < sizeof registers / sizeof *registers; i++)
        avr->io[AVR_DATA_TO_IO(registers[i].address)].w.c = registers[i].write;
    avr->io[AVR_DATA_TO_IO(TCNT1L)].r.c = read_tcnt;
    pin_irq = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('B'), 1);
    avr_irq_register_notify(pin_irq, pin_changed, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), 7), enable_changed, NULL);
}
