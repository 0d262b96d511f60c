// Conversions are triggered by timer 0 itself, at its compare A, one a turn of 128 us, so that no
// late interrupt makes them late. Compare B's interrupt turns the multiplexer 24 us behind each, when
// the converter has held what it converts (data sheet, 24.5). And when the last of a sample is held,
// 16 us after its trigger, it gives u to the motor. To find u takes 25 us, and two or three times that
// beside bytes that come at 1 Mbaud. So it is made ready before, in the 118 us from the multiplexer's
// turn to the hold, and bytes that leave wait meanwhile; what puts the motor off makes that void.
//
// The converter runs at 125 kHz: 13.5 clocks, 108 us a conversion. Full resolution asks for 200 kHz
// at most (data sheet, 24.4), and 250 kHz would gain little: the line alone takes 360 us for a
// SAMPLE at 1 Mbaud, and a sample takes the converter for 128 + 108 us.
//
// The long handlers, of the latch and of a conversion's end, let other interrupts in: the line's
// are due every 20 us, or 10.
//
// The shortest Ts: from 600 us on each sample is in time beside any line. But at 1 Mbaud main tells
// each only from 700 us on where many setpoints come at once; 500 kbaud carry one in 810 us.
#include "converter.h"

#include "board.h"
#include "clock.h"
#include "motor.h"
#include "pins.h"
#include "supply.h"
#include "uart.h"

#define SUPPLY_AS_REFERENCE _BV(REFS0)
#define QUIET (_BV(ADEN) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0)) // 16 MHz / 128
#define ON (QUIET | _BV(ADIE))
#define TRIGGERED (ON | _BV(ADATE))

enum {
    COUNTS_PER_US = 2, // of timer 0
    HOLD_COUNTS = (BOARD_HOLD_US - 2) * COUNTS_PER_US, // its interrupt takes 3 us to set OCR1A
    TURN_COUNTS = 24 * COUNTS_PER_US, // more than HOLD_COUNTS
    LEAD_COUNTS = 32, // 16 us: longer than it takes to set a trigger with interrupts off
    LEAD_US = LEAD_COUNTS / COUNTS_PER_US,
    OVERDUE_US = 50000,
};

static volatile enum {
    IDLE, // nothing is set
    SETTING, // something is being set, by who has made it this
    SET, // the first trigger is to come, after `turns_to_go` turns
    CONVERTS, // a conversion is under way
    ENDING, // the end of the run is to come, after `turns_to_go` turns
} phase;
static volatile uint16_t turns_to_go;
static uint16_t triggers, readings; // to come
static uint8_t what; // of the sample that is set or under way
static bool of_sample; // else of one channel
static uint8_t channel; // of the next reading
static bool is_turned; // the multiplexer, for the next trigger
static bool is_ready; // u, to be set at the hold
static bool is_broken; // a trigger came before the multiplexer was turned, or the hold before u
static uint32_t trigger_us; // the last one's, or the end

static volatile uint8_t asked; // samples that wait

static volatile bool timed; // the timer takes samples
static uint32_t timed_us, ts_us; // when the next one is triggered, and how long after the last
static uint32_t left; // how many there are still to be, where the run has an end
static bool has_end;

static volatile bool news; // a sample was taken, or the run has ended
static volatile uint8_t longest; // of our interrupts, in counts

void converter_turn_to(uint8_t to)
{
    ADMUX = SUPPLY_AS_REFERENCE | to;
}

void converter_convert(void)
{
    ADCSRA = ON | _BV(ADSC);
}

// Lets compare A be at `at_us`, after `turns_to_go` turns, and enter a phase; false where it is too
// late for that, or so far away that the turns cannot be counted.
static bool set_compare(uint32_t at_us, uint8_t next_phase)
{
    OCR0A = (uint8_t)(at_us * COUNTS_PER_US) - 1; // the flag comes with the count behind it
    const uint8_t before = board_irq_save();
    uint32_t now_us;
    do { // a compare until now is none of those
        TIFR0 = _BV(OCF0A);
        now_us = board_now_us();
    } while (TIFR0 & _BV(OCF0A));
    const bool in_time = (int32_t)(at_us - now_us) >= LEAD_US;
    if (in_time) {
        turns_to_go = ((at_us - now_us - 1) << 1) >> 8; // / TURN_US
        if (!turns_to_go && next_phase == SET)
            ADCSRA = TRIGGERED;
        phase = next_phase;
        TIMSK0 |= _BV(OCIE0A);
    }
    board_irq_restore(before);
    return in_time;
}

// Sets the first trigger as soon as can be; returns when the first of them is.
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
    const uint8_t to_go = OCR0A + 1 - (uint8_t)(now_us * COUNTS_PER_US); // counts; the half one, too
    board_irq_restore(before);
    return now_us + to_go / COUNTS_PER_US;
}

// Begins with one channel, or with alpha where they alternate.
static void begin_with(uint8_t first, uint16_t n)
{
    triggers = readings = n;
    channel = first;
    is_turned = true;
    converter_turn_to(first);
}

// Sets the sample of `what`, the last conversion of which is to be at `at_us` if the timer takes it.
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

// Sets what is to be done next. From who has made the phase SETTING; interrupts may be on.
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

// Returns whether the caller is to set what is next: nobody does, and the converter is free.
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

// Lets compare B come `counts` after compare A, in this turn or the next one.
static void set_compare_b(uint8_t counts)
{
    OCR0B = OCR0A + counts;
    TIFR0 = _BV(OCF0B);
    TIMSK0 |= _BV(OCIE0B);
}

// A conversion was triggered just now.
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
            ADCSRA = TRIGGERED; // from the next one on
        else
            supply_turn(turns_to_go < UINT8_MAX ? turns_to_go : UINT8_MAX);
    } else if (phase == ENDING) {
        end_run();
    } else {
        count_trigger();
    }
}

// Returns whether the last conversion of a sample is still to be held.
static bool is_before_hold(void)
{
    const bool is_triggered = triggers == 0 || TIFR0 & _BV(OCF0A);
    return !is_triggered || (uint8_t)(TCNT0 - OCR0A) < HOLD_COUNTS - 2 * COUNTS_PER_US;
}

// Finds u, which is to be set at the hold of the conversion that is triggered next.
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
    set_compare_b(HOLD_COUNTS); // which is in the next turn
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
            // A reading of the other channel is still to come.
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
        // Nothing to be told but the reading.
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
        converter_turn_to(channel); // for what may be set meanwhile
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
    phase = SETTING; // nobody else would: it is free, and nothing waits
    of_sample = false;
    begin_with(of ? ALPHA_CHANNEL : THETA_1_CHANNEL, n);
    trigger_us = set_now() + (uint32_t)(n - 1) * BOARD_SKEW_US;
}

void board_timer_start(uint32_t t0_us, uint32_t period_us, uint32_t k_stop)
{
    timed_us = t0_us; // no timer runs that could read them
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
    const bool runs = turns_to_go == 0 && TIFR0 & _BV(OCF0A); // its trigger has come
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
    ADCSRB = _BV(ADTS1) | _BV(ADTS0); // the trigger is compare A of timer 0
    DIDR0 = 0x3F; // the digital inputs of A0 to A5 off
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
    // And what comes before and behind: the registers saved, and the jump.
    return longest / COUNTS_PER_US + 4;
}
