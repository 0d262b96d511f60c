// The motor: 10-bit PWM on D9 by timer 1, 15.625 kHz, and the driver's enable line on D7.
//
// Zero is the pin disconnected and driven low. A duty of OCR1A = 0 would be a spike of one clock in
// each period (data sheet, 20.9.3), so that d steps are OCR1A = d - 1.
#include "board.h"
#include "motor.h"
#include "pins.h"

#define DISCONNECTED (_BV(WGM11) | _BV(WGM10))
#define CONNECTED (DISCONNECTED | _BV(COM1A1))
#define NORMAL_MODE _BV(COM1A1)
#define COUNTS (_BV(WGM12) | _BV(CS10))

enum { LAST_COUNTS = 1023 - 7 }; // half a microsecond before a period begins

// Before main, before even the variables have their values: whatever was before, 0 V.
__attribute__((naked, used, section(".init3"))) void motor_off_at_reset(void)
{
    TCCR1A = 0;
    PORTD = 0;
    DDRD = ENABLE_PIN;
    PORTB = 0;
    DDRB = PWM_PIN;
}

// Mode 7: fast PWM of 10 bits. Mode 14 would do, too, but simavr 1.6 has it wrong.
void motor_begin(void)
{
    board_motor_off();
    OCR1A = 0;
    TCCR1B = COUNTS;
}

static bool stages; // what is set is to be applied later
static volatile bool is_staged;
static uint16_t staged;

// Each pin is one write, as an interrupt could change what is read, changed and written back.
void board_motor_off(void)
{
    is_staged = false;
    TCCR1A = DISCONNECTED;
    PORTB = 0;
    PORTD = 0;
}

// Connects the pin, at the beginning of a period that has its duty already. A running PWM would take
// OCR1A over at the end of its period, and OC1A still has the level of when it was disconnected: up to
// a period of the run before (data sheet, 16.7, 16.8). So the timer stands, in normal mode, where OCR1A
// acts at once and a forced match clears OC1A; the pin is an input for these 2 us, low by its pull-down.
static void connect(uint16_t compare)
{
    TCCR1B = 0;
    DDRB = 0;
    TCCR1A = NORMAL_MODE;
    TCCR1C = _BV(FOC1A);
    OCR1A = compare;
    TCNT1 = LAST_COUNTS;
    TCCR1A = CONNECTED;
    DDRB = PWM_PIN;
    TCCR1B = COUNTS;
}

// Interrupts are off.
static void apply(uint16_t duty)
{
    PORTD = ENABLE_PIN;
    if (duty == 0) {
        TCCR1A = DISCONNECTED;
        PORTB = 0;
        return;
    }
    if (TCCR1A == CONNECTED)
        OCR1A = duty - 1; // taken over by the timer at the end of the period
    else
        connect(duty - 1);
}

void board_motor_set(uint16_t duty)
{
    if (!stages) {
        apply(duty);
        return;
    }
    staged = duty;
    is_staged = true;
}

void motor_stage(bool on)
{
    stages = on;
}

void motor_apply(void)
{
    if (is_staged)
        apply(staged);
    is_staged = false;
}
