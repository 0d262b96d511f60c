// Timer 0 itself triggers the conversions, at its compare match A, once in each turn of 128 us. A
// late interrupt handler therefore delays no conversion.
//
// The interrupt of compare match B has two tasks:
// - It sets the multiplexer 24 us after each trigger. By then the converter holds the input of the
//   present conversion (data sheet, 24.5).
// - It applies u when the last conversion of a sample is held, 16 us after its trigger.
//
// Finding u takes 25 us, and two or three times as long while bytes arrive at 1 Mbaud. The handler
// therefore finds u in advance, in the 118 us between the setting of the multiplexer and the hold.
// Transmission pauses meanwhile. If the motor is turned off before the hold, this u is discarded.
//
// The converter runs at 125 kHz: 13.5 clocks, or 108 us, for a conversion. Full resolution permits
// at most 200 kHz (data sheet, 24.4). A clock of 250 kHz would gain little. At 1 Mbaud a SAMPLE
// occupies the line for 360 us, and a sample occupies the converter for 128 + 108 us.
//
// The long handlers enable other interrupts while they find u or end a conversion. A byte on the
// line needs an interrupt every 20 us at 500 kbaud, and every 10 us at 1 Mbaud.
//
// The shortest Ts is 800 us. With a Ts of 600 us or more, each sample is taken in time, whatever
// arrives on the line. At 1 Mbaud, while many setpoints arrive, main sends every SAMPLE only if Ts
// is at least 700 us.
// At 500 kbaud the line itself needs a Ts of 810 us (daemon/armrig_daemon/decisions/budget.py).
#include "converter.h"

#include "board.h"
#include "clock.h"
#include "motor.h"
#include "pins.h"
#include "supply.h"
#include "uart.h"

#define QUIET (_BV(ADEN) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0)) // 16 MHz / 128
#define ON (QUIET | _BV(ADIE))
#define TRIGGERED (ON | _BV(ADATE))

enum {
    COUNTS_PER_US = 2, // counts of timer 0
    HOLD_COUNTS = (BOARD_HOLD_US - 2) * COUNTS_PER_US, // the handler takes 3 us to set OCR1A
    TURN_COUNTS = 24 * COUNTS_PER_US, // must be more than HOLD_COUNTS
    LEAD_COUNTS = 32, // 16 us: setting a trigger with interrupts off takes less
    LEAD_US = LEAD_COUNTS / COUNTS_PER_US,
    OVERDUE_US = 50000,
};

static volatile enum {
    IDLE, // nothing is scheduled
    SETTING, // the code that chose this phase is scheduling the next event
    SET, // the first trigger follows after `turns_to_go` turns
    CONVERTS, // a conversion is in progress
    ENDING, // the end of the run follows after `turns_to_go` turns
} phase;
static volatile uint16_t turns_to_go;
static uint16_t triggers, readings; // triggers and readings still to come
static uint8_t what; // kind of the sample that is scheduled or in progress
static bool of_sample; // the conversions are of a sample, not of board_convert_channel
static uint8_t channel; // channel of the next reading
static bool is_turned; // the multiplexer is set for the next trigger
static bool is_ready; // u was found, and will be applied at the hold
static bool is_broken; // a trigger preceded the multiplexer's setting, or the hold preceded u
static uint32_t trigger_us; // time of the sample's last trigger, or of the run's end

static volatile uint8_t asked; // requested samples that wait or are in progress

static volatile bool timed; // the timer takes samples
static uint32_t timed_us, ts_us; // time of the next sample's last trigger; period
static uint32_t left; // samples still to be taken if the run has an end
static bool has_end;

static volatile bool news; // a sample was taken, or the run has ended
static volatile uint8_t longest; // longest handler of this file, in counts

void converter_turn_to(uint8_t to)
{
    ADMUX = REFERENCE | INPUT_OF(to);
}

void converter_convert(void)
{
    ADCSRA = ON | _BV(ADSC);
}

// Schedules compare match A for `at_us`, and enters `next_phase`. Returns false if `at_us` is less
// than LEAD_US ahead. `at_us` must be less than 8.3 s ahead, because `turns_to_go` has 16 bits.
static bool set_compare(uint32_t at_us, uint8_t next_phase)
{
    OCR0A = (uint8_t)(at_us * COUNTS_PER_US) - 1; // the flag is set one count after OCR0A
    const uint8_t before = board_irq_save();
    uint32_t now_us;
    do { // discard a compare match that precedes `now_us`
        TIFR0 = _BV(OCF0A);
        now_us = board_now_us();
    } while (TIFR0 & _BV(OCF0A));
    const bool in_time = (int32_t)(at_us - now_us) >= LEAD_US;
    if (in_time) {
        turns_to_go = ((at_us - now_us - 1) << 1) >> 8; // divided by TURN_US
        if (!turns_to_go && next_phase == SET)
            ADCSRA = TRIGGERED;
        phase = next_phase;
        TIMSK0 |= _BV(OCIE0A);
    }
    board_irq_restore(before);
    return in_time;
}

// Schedules the first trigger as early as possible, and returns its time.
static uint32_t set_now(void)
{
    const uint8_t before = board_irq_save();
    OCR0A = TCNT0 + (LEAD_COUNTS - 1);
    TIFR0 = _BV(OCF0A);
    ADCSRA = TRIGGERED;
    turns_to_go = 0;
    phase = SET;
    TIMSK0 |= _BV(OCIE0A);
    const uint32_t now_us = board_now_us();
    const uint8_t to_go = OCR0A + 1 - (uint8_t)(now_us * COUNTS_PER_US); // now_us lacks the half us
    board_irq_restore(before);
    return now_us + to_go / COUNTS_PER_US;
}

// Prepares `n` conversions, the first of them of the channel `first`.
static void begin_with(uint8_t first, uint16_t n)
{
    triggers = readings = n;
    channel = first;
    is_turned = true;
    converter_turn_to(first);
}

// Schedules a sample of the kind `what`. If the timer takes it, `at_us` is the time of its last
// trigger.
static void set_sample(uint32_t at_us)
{
    const uint16_t n = 2 * (uint16_t)rig_oversampling();
    const uint32_t takes_us = (uint32_t)(n - 1) * BOARD_SKEW_US;
    of_sample = true;
    begin_with(ALPHA_CHANNEL, n);
    trigger_us = at_us;
    if (what == RIG_TIMED && set_compare(at_us - takes_us, SET))
        return;
    if (what == RIG_TIMED)
        what |= RIG_LATE;
    trigger_us = set_now() + takes_us;
}

// Schedules the next sample, or the end of the run. The caller has set the phase to SETTING.
// Interrupts may be on.
static void set_next(bool waited)
{
    if (asked) {
        what = waited ? RIG_ASKED | RIG_LATE : RIG_ASKED;
        set_sample(0);
    } else if (timed && has_end && !left) {
        trigger_us = timed_us + BOARD_HOLD_US;
        if (!set_compare(trigger_us, ENDING))
            set_compare(board_now_us() + TURN_US, ENDING);
    } else if (timed) {
        what = RIG_TIMED;
        set_sample(timed_us);
    } else {
        phase = IDLE;
    }
}

// Returns true if a sample or the end of a run must be scheduled and the converter is free. The
// caller then calls `set_next`. Interrupts are off.
static bool claims(void)
{
    const bool free = phase == IDLE && (asked || timed) && supply_yields();
    if (free)
        phase = SETTING;
    return free;
}

static void note_length(uint8_t began)
{
    const uint8_t took = TCNT0 - began;
    if (took > longest)
        longest = took;
}

// Schedules compare match B `counts` after compare match A, in this turn or the next.
static void set_compare_b(uint8_t counts)
{
    OCR0B = OCR0A + counts;
    TIFR0 = _BV(OCF0B);
    TIMSK0 |= _BV(OCIE0B);
}

// Counts a conversion that timer 0 has just triggered.
static void count_trigger(void)
{
    phase = CONVERTS;
    is_broken |= !is_turned;
    if (--triggers == 0) {
        ADCSRA = ON;
        TIMSK0 &= (uint8_t)~_BV(OCIE0A);
    } else {
        is_turned = false;
        set_compare_b(TURN_COUNTS);
    }
}

static void end_run(void)
{
    TIMSK0 &= (uint8_t)~_BV(OCIE0A);
    timed = false;
    phase = IDLE;
    news = true;
    rig_end();
}

ISR(TIMER0_COMPA_vect)
{
    if (turns_to_go) {
        if (--turns_to_go == 0 && phase == SET)
            ADCSRA = TRIGGERED; // from the next compare match on
        else
            supply_turn(turns_to_go < UINT8_MAX ? turns_to_go : UINT8_MAX);
    } else if (phase == ENDING) {
        end_run();
    } else {
        count_trigger();
    }
}

// Returns true if the last conversion of the sample is not held yet.
static bool is_before_hold(void)
{
    const bool is_triggered = triggers == 0 || TIFR0 & _BV(OCF0A);
    return !is_triggered || (uint8_t)(TCNT0 - OCR0A) < HOLD_COUNTS - 2 * COUNTS_PER_US;
}

// Finds u. It is applied at the hold of the conversion that is triggered next.
static void make_ready(void)
{
    motor_stage(true);
    uart_pause();
    sei();
    rig_latch(what);
    cli();
    uart_go_on();
    motor_stage(false);
    is_broken |= !is_before_hold();
    is_ready = true;
    set_compare_b(HOLD_COUNTS); // the hold is in the next turn
}

ISR(TIMER0_COMPB_vect)
{
    const uint8_t began = TCNT0;
    TIMSK0 &= (uint8_t)~_BV(OCIE0B);
    if (is_ready) {
        is_ready = false;
        motor_apply();
    } else {
        is_turned = true;
        if (of_sample) {
            // At least one conversion of the other channel follows.
            converter_turn_to(channel ^ THETA_1_CHANNEL ^ ALPHA_CHANNEL);
            if (triggers == 1)
                make_ready();
        }
    }
    note_length(began);
}

static void end_last(uint16_t code)
{
    phase = SETTING;
    if (!of_sample) {
        // Report only the reading: it is not of a sample.
    } else if (what & RIG_TIMED) {
        timed_us += ts_us;
        left--;
    } else {
        asked--;
    }
    supply_offer();
    sei();
    rig_reading(channel == ALPHA_CHANNEL, code);
    if (of_sample)
        rig_converted(what, trigger_us);
    news = true;
    set_next(true);
    cli();
}

static void end_conversion(uint16_t code)
{
    const uint8_t of = channel;
    if (of_sample)
        channel ^= THETA_1_CHANNEL ^ ALPHA_CHANNEL;
    sei();
    rig_reading(of == ALPHA_CHANNEL, code);
    cli();
}

ISR(ADC_vect)
{
    const uint8_t began = TCNT0;
    const uint16_t reading = ADC, code = reading << (16 - BOARD_ADC_BITS);
    if (phase == CONVERTS && --readings)
        end_conversion(code);
    else if (phase == CONVERTS)
        end_last(code);
    else if (supply_end(reading)) {
        converter_turn_to(channel); // restore the channel of a sample that may be scheduled
        if (claims())
            set_next(true);
    }
    note_length(began);
}

void converter_turn(void)
{
    const uint8_t before = board_irq_save();
    if (phase == IDLE)
        supply_turn(UINT8_MAX);
    board_irq_restore(before);
}

bool converter_has_news(void)
{
    const bool had = news;
    news = false;
    return had;
}

void board_convert_now(void)
{
    const uint8_t before = board_irq_save();
    asked++;
    const bool mine = claims();
    board_irq_restore(before);
    if (mine)
        set_next(false);
}

bool board_converter_is_free(void)
{
    return phase == IDLE && supply_is_at_rest();
}

void board_convert_channel(uint8_t of, uint16_t n)
{
    phase = SETTING; // no interrupt changes it: the converter is free, no sample waits
    of_sample = false;
    begin_with(of ? ALPHA_CHANNEL : THETA_1_CHANNEL, n);
    trigger_us = set_now() + (uint32_t)(n - 1) * BOARD_SKEW_US;
}

void board_timer_start(uint32_t t0_us, uint32_t period_us, uint32_t k_stop)
{
    timed_us = t0_us; // the timer is stopped, so that no interrupt reads these variables
    ts_us = period_us;
    left = k_stop;
    has_end = k_stop != 0;
    const uint8_t before = board_irq_save();
    timed = true;
    const bool mine = claims();
    board_irq_restore(before);
    if (mine)
        set_next(false);
}

void board_timer_stop(void)
{
    const uint8_t before = board_irq_save();
    const bool runs = turns_to_go == 0 && TIFR0 & _BV(OCF0A); // the first trigger has come
    const bool mine = phase == ENDING || (phase == SET && of_sample && what & RIG_TIMED && !runs);
    timed = false;
    if (mine) {
        TIMSK0 &= (uint8_t)~_BV(OCIE0A);
        ADCSRA = ON;
        phase = SETTING;
    }
    board_irq_restore(before);
    if (mine)
        set_next(true);
}

void converter_begin(void)
{
    ADCSRB = _BV(ADTS1) | _BV(ADTS0); // the trigger is compare match A of timer 0
    DIDR0 = 0x3F; // disable the digital inputs of A0 to A5
    ADCSRA = ON;
}

uint16_t converter_read(uint8_t of)
{
    converter_turn_to(of);
    ADCSRA = QUIET | _BV(ADSC);
    while (ADCSRA & _BV(ADSC))
        ;
    return ADC;
}

bool converter_is_alive(void)
{
    const uint8_t before = board_irq_save();
    const bool alive = phase == IDLE || (int32_t)(board_now_us() - trigger_us) < OVERDUE_US;
    board_irq_restore(before);
    return alive && !is_broken;
}

uint16_t board_isr_max_us(void)
{
    // 4 us more: the jump, and saving and restoring the registers.
    return longest / COUNTS_PER_US + 4;
}
