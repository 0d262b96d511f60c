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
    R2_FROM = 0x0406, // Optiboot 4.6, the first version that passes MCUSR on
    R2_UP_TO = 0x0FFF, // a larger word is erased flash or another loader
};

extern uint8_t _end, __stack; // linker symbols: end of the variables, first byte of the stack

static uint8_t reset_flags;
static uint8_t fed_turn;

// Returns the reset flags if MCUSR is 0. Optiboot then has cleared MCUSR and passes its value on in
// r2, which nothing has written since. The last word of flash is Optiboot's version. An older
// version, such as the 4.4 of most boards, leaves r2 undefined: the cause is unknown, 0.
static inline uint8_t handed_on(uint8_t r2)
{
    const uint16_t version = pgm_read_word(FLASHEND - 1);
    return version >= R2_FROM && version <= R2_UP_TO ? r2 : 0;
}

// Runs before main. Saves the cause of the reset, and sets the watchdog, which is still on after a
// reset by the watchdog. Then fills the stack with PAINT, so that board_stack_free can find its
// deepest use.
__attribute__((naked, used, section(".init5"))) void note_reset(void)
{
    uint8_t r2;
    __asm__ volatile("mov %0, r2" : "=r"(r2));
    reset_flags = MCUSR ? MCUSR : handed_on(r2);
    MCUSR = 0;
    wdt_enable(WDTO_250MS);
    wdt_reset(); // simavr 1.6 applies the new period only here
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

// Feeds the hardware watchdog if the clock runs and no sample is overdue. Main calls the function
// in each poll, so that the watchdog also resets a main loop that hangs.
void board_feed_watchdog(void)
{
    const uint8_t turn = clock_turns();
    if (turn != fed_turn && converter_is_alive()) {
        fed_turn = turn;
        wdt_reset();
    }
}

// Sleeps until the next interrupt. At least one interrupt occurs in each turn of the clock.
static void wait(void)
{
    sleep_enable();
    sleep_cpu();
    sleep_disable();
}

// Returns true every second turn of the clock, and after a sample or the end of a run. More
// frequent polls would lose received bytes.
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
