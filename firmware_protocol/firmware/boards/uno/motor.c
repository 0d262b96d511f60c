// The motor: 10-bit PWM on D9 by timer 1, 15.625 kHz, and the driver's enable line on D7.
//
// Zero is the pin disconnected and driven low. A duty of OCR1A = 0 would be a spike of one clock in
// each period (data sheet, 20.9.3), so that d steps are OCR1A = d - 1.
#include "board.h"
#include "motor.h"
#include "pins.h"

#define DISCONNECTED (_BV(WGM11) | _BV(WGM10))
#define CONNECTED (DISCONNECTED | _BV(COM1A1))

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
    TCCR1B = _BV(WGM12) | _BV(CS10);
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

static void apply(uint16_t duty)
{
    PORTD = ENABLE_PIN;
    if (duty == 0) {
        TCCR1A = DISCONNECTED;
        PORTB = 0;
        return;
    }
    OCR1A = duty - 1; // taken over by the timer at the end of the period
    TCCR1A = CONNECTED;
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
