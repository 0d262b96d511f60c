// The motor: the PWM pin and the driver's enable line, if the layout has one.
//
// At 0 V the pin is disconnected and driven low. A compare value of 0 would cause a spike of one
// count in each period (data sheet, 20.9.3). A duty of d steps is therefore d - 1.
//
// The enable line is on port D. The PWM pin may also be on port D: while the timer drives the pin,
// the value of the port does not matter.
#include "board.h"
#include "motor.h"
#include "pins.h"

// Sets the motor to 0 V before main, and before the variables are initialised.
__attribute__((naked, used, section(".init3"))) void motor_off_at_reset(void)
{
    PWM_MODE = 0;
    PORTD = 0;
    DDRD = ENABLE_PIN;
    PWM_PORT = 0;
    PWM_DDR = PWM_PIN;
}

void motor_begin(void)
{
    board_motor_off();
    PWM_COMPARE = 0;
    PWM_CLOCK = COUNTS;
}

static bool stages; // board_motor_set stores its duty, which motor_apply applies
static volatile bool is_staged;
static uint16_t staged;

// Each port is one write. In a read-modify-write, an interrupt could change the port between the
// read and the write.
void board_motor_off(void)
{
    is_staged = false;
    PWM_MODE = DISCONNECTED;
    PWM_PORT = 0;
    PORTD = 0;
}

// Connects the pin at the beginning of a period that already has the new duty. With a running
// timer, two effects would repeat the previous run's output for up to one period (data sheet, 16.7,
// 16.8):
// - The timer loads its compare register only at the end of its period.
// - The timer's output still has the level at which the pin was disconnected.
//
// The timer is therefore stopped and set to normal mode. There, the compare register acts at once,
// and a forced match clears the output. For these 2 us the pin is an input, and its pull-down keeps it low.
static void connect(uint16_t compare)
{
    PWM_CLOCK = 0;
    PWM_DDR = 0;
    PWM_MODE = NORMAL_MODE;
    FORCE_MATCH();
    PWM_COMPARE = compare;
    PWM_COUNTER = LAST_COUNTS;
    PWM_MODE = CONNECTED;
    PWM_DDR = PWM_PIN;
    PWM_CLOCK = COUNTS;
}

// Applies a duty to the pins. Interrupts are off.
static void apply(uint16_t duty)
{
    if (ENABLE_PIN)
        PORTD = ENABLE_PIN;
    if (duty == 0) {
        PWM_MODE = DISCONNECTED;
        PWM_PORT = 0;
        return;
    }
    if (PWM_MODE == CONNECTED)
        PWM_COMPARE = duty - 1; // the timer loads it at the end of the period
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
