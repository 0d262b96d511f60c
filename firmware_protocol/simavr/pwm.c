// SPDX-License-Identifier: GPL-3.0-or-later
// The PWM, by timer 1 on pin D9 (PB1, OC1A) or by timer 2 on pin D3 (PD3, OC2B). The duty is
// measured at the pin: the time for which the pin is high in each period.
//
// simavr's own timers are not used, because they differ from silicon in three points:
// - A new compare value acts in the middle of a period.
// - The pin is low if the compare value is TOP.
// - The timer's output loses its level while the pin is disconnected.
//
// This file models the normal mode and fast PWM (mode 7 of timer 1, 10 bits; mode 3 of timer 2, 8
// bits) as on silicon. The timer's output is disconnected, or cleared on a match.
#include <string.h>
#include <avr_ioport.h>
#include <sim_cycle_timers.h>
#include "fil.h"

enum { TCCR1A = 0x80, TCCR1B = 0x81, TCCR1C = 0x82, TCNT1L = 0x84, TCNT1H = 0x85, OCR1AL = 0x88, OCR1AH = 0x89 };
enum { TCCR2A = 0xb0, TCCR2B = 0xb1, TCNT2 = 0xb2, OCR2B = 0xb4 };
enum { DDRB = 0x24, PORTB = 0x25, DDRD = 0x2a, PORTD = 0x2b };
enum { WGM = 0x03, CS = 0x07, FOC1A = 0x80, FOC2B = 0x40 };

// A PWM pin and its timer.
static const struct pwm {
    char port;
    uint8_t bit; // number of the pin in its port
    uint16_t ddr, out; // registers of the port
    uint16_t mode; // register that connects the pin
    uint8_t connects; // bit of `mode`: cleared on a match
    uint16_t top; // last count of a period
    uint16_t ticks[8]; // cycles for one count, by the clock select bits; 0: stopped
    int has_enable; // the layout has an enable line, D7
} d9 = {'B', 1, DDRB, PORTB, TCCR1A, 0x80, 1023, {0, 1, 8, 64, 256, 1024, 0, 0}, 1},
  d3 = {'D', 3, DDRD, PORTD, TCCR2A, 0x20, 255, {0, 1, 8, 32, 64, 128, 256, 1024}, 0};

static const struct pwm *pwm = &d9;
static avr_t *the_avr;
static avr_irq_t *pin_irq;
static cycles_t tick = 1; // cycles for one count
static uint8_t temp; // the high byte of a 16-bit write: silicon's TEMP register
static uint16_t ocr, ocr_buffer;
static int runs, output; // 1 if the timer counts; the output level of the timer
static cycles_t bottom_at; // cycle at which the counter was 0, while the timer runs
static uint16_t stands_at; // value of the counter, while the timer is stopped
static int pin, enable;
static cycles_t edge_at; // cycle of the timer's edge: simavr is up to an instruction late
static cycles_t rose, period_began;
static uint32_t high; // cycles of this period with the pin high, up to its last fall
static uint32_t told = UINT32_MAX;

static cycles_t period(void) {
    return (pwm->top + 1U) * tick;
}

// Report the duty of the period that ends if it differs from that of the period before.
static void end_period(cycles_t when) {
    if (pin) {
        high += (uint32_t)(when - rose);
        rose = when;
    }
    if (high > period())
        high = (uint32_t)period(); // the pin was high before the timer was started
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
    if (pin && !enable && pwm->has_enable)
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
    return the_avr->data[pwm->mode] & pwm->connects;
}

// Set the pin to the level of the timer or of the port, at a cycle. An input is pulled down.
static void set_pin(cycles_t when) {
    int level = is_connected() ? output : the_avr->data[pwm->out] >> pwm->bit & 1;
    edge_at = when;
    avr_raise_irq(pin_irq, level && the_avr->data[pwm->ddr] >> pwm->bit & 1);
    edge_at = 0;
}

// Set the timer's output. While the pin is disconnected, the output keeps its level.
static void set_output(cycles_t when, int level) {
    if (!is_connected())
        return;
    output = level;
    set_pin(when);
}

static cycles_t match(avr_t *avr, cycles_t when, void *param) {
    (void)avr, (void)param;
    set_output(when, 0);
    return 0;
}

static cycles_t bottom(avr_t *avr, cycles_t when, void *param) {
    (void)param;
    end_period(when);
    judge(when);
    bottom_at = when;
    ocr = ocr_buffer;
    set_output(when, 1);
    if (ocr < pwm->top)
        avr_cycle_timer_register(avr, when + (ocr + 1U) * tick - avr->cycle, match, NULL);
    return when + period();
}

static void stop(avr_t *avr) {
    if (runs)
        stands_at = (uint16_t)((avr->cycle - bottom_at) / tick);
    runs = 0;
    avr_cycle_timer_cancel(avr, match, NULL);
    avr_cycle_timer_cancel(avr, bottom, NULL);
}

// Start the timer. The first count is a whole one: the prescaler's phase is not modelled.
static void go_on(avr_t *avr) {
    runs = 1;
    bottom_at = avr->cycle - stands_at * tick;
    avr_cycle_timer_register(avr, period() - stands_at * tick, bottom, NULL);
    if (stands_at <= ocr && ocr < pwm->top)
        avr_cycle_timer_register(avr, (ocr + 1U - stands_at) * tick, match, NULL);
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
    if (pwm->ticks[v & CS]) {
        tick = pwm->ticks[v & CS];
        go_on(avr);
    }
}

// A forced match, which exists only in normal mode.
static void force_match(avr_t *avr) {
    if (!(avr->data[pwm->mode] & WGM))
        set_output(avr->cycle, 0);
}

static void write_tccrc(avr_t *avr, avr_io_addr_t addr, uint8_t v, void *param) {
    (void)addr, (void)param;
    if (v & FOC1A)
        force_match(avr);
}

// Timer 2 has the bit of the forced match in the register of the clock.
static void write_tccr2b(avr_t *avr, avr_io_addr_t addr, uint8_t v, void *param) {
    write_tccrb(avr, addr, v & (uint8_t)~FOC2B, param);
    if (v & FOC2B)
        force_match(avr);
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
    stands_at = (uint16_t)(temp << 8 | v) & pwm->top;
    if (ran)
        go_on(avr);
}

static uint8_t read_tcnt(avr_t *avr, avr_io_addr_t addr, void *param) {
    (void)param;
    uint16_t count = runs ? (uint16_t)((avr->cycle - bottom_at) / tick) & pwm->top : stands_at;
    if (addr == TCNT1L)
        avr->data[TCNT1H] = (uint8_t)(count >> 8);
    return avr->data[addr] = (uint8_t)count;
}

// In fast PWM, a new compare value acts from the next period on.
static void write_ocr(avr_t *avr, avr_io_addr_t addr, uint8_t v, void *param) {
    (void)addr, (void)param;
    ocr_buffer = (uint16_t)(temp << 8 | v);
    if (!(avr->data[pwm->mode] & WGM))
        ocr = ocr_buffer;
}

// After a reset, all pins are inputs, and external resistors pull them down.
void pwm_reset(avr_t *avr) {
    if (pin)
        high += (uint32_t)(avr->cycle - rose);
    pin = enable = 0;
    stop(avr);
    ocr = ocr_buffer = stands_at = 0;
    output = 0;
    end_period(avr->cycle);
    end_period(avr->cycle); // report the low level: no period ends before the timer is started
}

// Watch the pins, and replace simavr's timer. `pin_name` is D9 or D3; return 0 for another pin.
int pwm_attach(avr_t *avr, const char *pin_name) {
    static const struct {
        uint16_t address;
        avr_io_write_t write;
    } registers[] = {
        {TCCR1A, write_tccra}, {TCCR1B, write_tccrb}, {TCCR1C, write_tccrc}, {TCNT1L, write_tcnt},
        {TCNT1H, write_high}, {OCR1AL, write_ocr}, {OCR1AH, write_high},
    }, registers_2[] = {
        {TCCR2A, write_tccra}, {TCCR2B, write_tccr2b}, {TCNT2, write_tcnt}, {OCR2B, write_ocr},
    };
    int is_d3 = !strcmp(pin_name, "D3");
    if (!is_d3 && strcmp(pin_name, "D9"))
        return 0;
    the_avr = avr;
    pwm = is_d3 ? &d3 : &d9;
    if (is_d3)
        for (size_t i = 0; i < sizeof registers_2 / sizeof *registers_2; i++)
            avr->io[AVR_DATA_TO_IO(registers_2[i].address)].w.c = registers_2[i].write;
    else
        for (size_t i = 0; i < sizeof registers / sizeof *registers; i++)
            avr->io[AVR_DATA_TO_IO(registers[i].address)].w.c = registers[i].write;
    avr->io[AVR_DATA_TO_IO(is_d3 ? TCNT2 : TCNT1L)].r.c = read_tcnt;
    pin_irq = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(pwm->port), pwm->bit);
    avr_irq_register_notify(pin_irq, pin_changed, NULL);
    if (pwm->has_enable)
        avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), 7), enable_changed, NULL);
    return 1;
}

// Add the levels of the pins to a trace.
void pwm_trace(avr_vcd_t *vcd) {
    avr_vcd_add_signal(vcd, pin_irq, 1, "pwm");
    if (pwm->has_enable)
        avr_vcd_add_signal(vcd, avr_io_getirq(the_avr, AVR_IOCTL_IOPORT_GETIRQ('D'), 7), 1, "enable");
}
