// The motor: 10-bit PWM on D9 by timer 1, 15.625 kHz, and the driver's enable line on D7.
//
// At 0 V the pin is disconnected and driven low. OCR1A = 0 would cause a spike of one clock in each
// period (data sheet, 20.9.3). A duty of d steps is therefore OCR1A = d - 1.
#include "board.h"
#include "motor.h"
#include "pins.h"

#define DISCONNECTED (_BV(WGM11) | _BV(WGM10))
#define CONNECTED (DISCONNECTED | _BV(COM1A1))
#define NORMAL_MODE _BV(COM1A1)
#define COUNTS (_BV(WGM12) | _BV(CS10))

enum { LAST_COUNTS = 1023 - 7 }; // half a microsecond before the end of a period

// Sets the motor to 0 V before main, and before the variables are initialised.
__attribute__((naked, used, section(".init3"))) void motor_off_at_reset(void)
{
    TCCR1A = 0;
    PORTD = 0;
    DDRD = ENABLE_PIN;
    PORTB = 0;
    DDRB = PWM_PIN;
}

// Mode 7: fast PWM, 10 bits. On silicon, mode 14 would also be correct, but simavr 1.6 models it
// wrongly.
void motor_begin(void)
{
    board_motor_off();
    OCR1A = 0;
    TCCR1B = COUNTS;
}

static bool stages; // board_motor_set stores its duty, which motor_apply applies
static volatile bool is_staged;
static uint16_t staged;

// Each port is one write. In a read-modify-write, an interrupt could change the port between the
// read and the write.
void board_motor_off(void)
{
    is_staged = false;
    TCCR1A = DISCONNECTED;
    PORTB = 0;
    PORTD = 0;
}

// Connects the pin at the beginning of a period that already has the new duty. With a running
// timer, two effects would repeat the previous run's output for up to one period (data sheet, 16.7,
// 16.8):
// - The timer loads OCR1A only at the end of its period.
// - OC1A still has the level at which the pin was disconnected.
//
// The timer is therefore stopped and set to normal mode. There, OCR1A acts at once, and a forced
// match clears OC1A. For these 2 us the pin is an input, and its pull-down keeps it low.
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

// Applies a duty to the pins. Interrupts are off.
static void apply(uint16_t duty)
{
    PORTD = ENABLE_PIN;
    if (duty == 0) {
        TCCR1A = DISCONNECTED;
        PORTB = 0;
        return;
    }
    if (TCCR1A == CONNECTED)
        OCR1A = duty - 1; // the timer loads it at the end of the period
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
