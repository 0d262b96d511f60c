// The Uno's main loop, its watchdog and its stack.
#include <avr/sleep.h>
#include <avr/wdt.h>

#include "board.h"
#include "clock.h"
#include "converter.h"
#include "identity.h"
#include "motor.h"
#include "uart.h"

enum { PAINT = 0xC5 };

extern uint8_t _end, __stack; // of the linker: the end of the variables, the beginning of the stack

static uint8_t reset_flags;
static uint8_t fed_turn;

// Before main: the reset's cause, while it is known, and the watchdog, which is still on after it
// has bitten. Then the stack is painted, to see later how far it came.
__attribute__((naked, used, section(".init5"))) void note_reset(void)
{
    reset_flags = MCUSR; // 0 where a boot loader has cleared it
    MCUSR = 0;
    wdt_enable(WDTO_250MS);
    wdt_reset(); // simavr 1.6 takes the new period over with this alone
    for (uint8_t *at = &_end; at <= &__stack; at++)
        *at = PAINT;
}

uint8_t board_reset_flags(void)
{
    return reset_flags;
}

uint16_t board_stack_free(void)
{
    const uint8_t *at = &_end;
    while (at <= &__stack && *at == PAINT)
        at++;
    return at - &_end;
}

// The hardware's watchdog is fed where main comes by here, time goes on and samples are taken.
void board_feed_watchdog(void)
{
    const uint8_t turn = clock_turns();
    if (turn != fed_turn && converter_is_alive()) {
        fed_turn = turn;
        wdt_reset();
    }
}

// Sleeps until an interrupt, one of which comes in each turn of the clock.
static void wait(void)
{
    sleep_enable();
    sleep_cpu();
    sleep_disable();
}

// Every second turn of the clock, and when there is news; more often would cost bytes.
static bool is_time_to_poll(void)
{
    static uint8_t last;
    const uint8_t turn = clock_turns();
    const bool is_time = (uint8_t)(turn - last) >= 2;
    if (is_time) {
        last = turn;
        converter_turn();
    }
    return converter_has_news() || is_time;
}

int main(void)
{
    motor_begin();
    clock_begin();
    converter_begin();
    sei();
    identity_begin();
    board_firmware_crc();
    uart_begin();
    set_sleep_mode(SLEEP_MODE_IDLE);
    rig_begin();
    for (;;) {
        if (is_time_to_poll())
            rig_poll();
        const int16_t byte = uart_next();
        if (byte >= 0)
            rig_receive((uint8_t)byte);
        else
            wait();
    }
}
