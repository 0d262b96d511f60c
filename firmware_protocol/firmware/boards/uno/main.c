// The Uno's main loop, its watchdog and its stack.
#include <avr/pgmspace.h>
#include <avr/sleep.h>
#include <avr/wdt.h>

#include "board.h"
#include "clock.h"
#include "converter.h"
#include "identity.h"
#include "motor.h"
#include "uart.h"

enum {
    PAINT = 0xC5,
    R2_FROM = 0x0406, // Optiboot 4.6: since then it hands MCUSR on
    R2_UP_TO = 0x0FFF, // what is above is no version of Optiboot's: erased flash, or another loader's
};

extern uint8_t _end, __stack; // of the linker: the end of the variables, the beginning of the stack

static uint8_t reset_flags;
static uint8_t fed_turn;

// Returns why it was reset where MCUSR is 0: Optiboot has cleared it, and hands it on in r2, which
// nothing has written since. Its version is the last word of flash. Of an older one, such as the 4.4
// that most boards come with, r2 is nobody's: the cause is not known, 0.
static inline uint8_t handed_on(uint8_t r2)
{
    const uint16_t version = pgm_read_word(FLASHEND - 1);
    return version >= R2_FROM && version <= R2_UP_TO ? r2 : 0;
}

// Before main: the reset's cause, while it is known, and the watchdog, which is still on after it
// has bitten. Then the stack is painted, to see later how far it came.
__attribute__((naked, used, section(".init5"))) void note_reset(void)
{
    uint8_t r2;
    __asm__ volatile("mov %0, r2" : "=r"(r2));
    reset_flags = MCUSR ? MCUSR : handed_on(r2);
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
