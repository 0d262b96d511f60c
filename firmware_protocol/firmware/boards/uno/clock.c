#include "clock.h"

#include "board.h"

static volatile uint32_t turns; // written by the interrupt

ISR(TIMER0_OVF_vect)
{
    turns++;
}

void clock_begin(void)
{
    TCCR0A = 0;
    TCCR0B = _BV(CS01); // 16 MHz / 8
    TIMSK0 = _BV(TOIE0);
}

uint32_t board_now_us(void)
{
    const uint8_t before = board_irq_save();
    const uint8_t count = TCNT0;
    uint32_t whole = turns;
    if (TIFR0 & _BV(TOV0) && count < 128) // an overflow that the interrupt has not counted yet
        whole++;
    board_irq_restore(before);
    return whole << 7 | count >> 1;
}

uint8_t clock_turns(void)
{
    return *(volatile uint8_t *)&turns;
}
