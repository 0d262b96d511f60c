#include "supply.h"

#include "board.h"
#include "converter.h"
#include "pins.h"

enum {
    BANDGAP_CHANNEL = 14,
    BANDGAP_MV = 1100, // within 10 %: data sheet, table 29-11
    NEEDS = 3, // turns: one to settle (data sheet: 70 us), one to convert, one in reserve
    PATIENCE = 100, // turns to wait for the end of a sample; main counts every second turn: 26 ms
};

static volatile enum {
    AT_REST,
    WANTED, // requested by main, `waited` turns ago
    OFFERED, // requested, and a sample has ended or PATIENCE is over
    SETTLES,
    IS_CONVERTED,
} step;
static uint8_t waited;

void board_measure_supply(void)
{
    if (REFERENCE != SUPPLY_AS_REFERENCE)
        return;
    const uint8_t before = board_irq_save();
    if (step == AT_REST) {
        step = WANTED;
        waited = 0;
    }
    board_irq_restore(before);
}

void supply_offer(void)
{
    if (step == WANTED)
        step = OFFERED;
}

void supply_turn(uint8_t free_turns)
{
    if (step == AT_REST)
        return;
    if (step == WANTED && ++waited == PATIENCE)
        step = OFFERED;
    if (step == OFFERED && free_turns >= NEEDS) {
        step = SETTLES;
        converter_turn_to(BANDGAP_CHANNEL);
    } else if (step == SETTLES) {
        step = IS_CONVERTED;
        converter_convert();
    }
}

bool supply_yields(void)
{
    if (step == SETTLES)
        step = WANTED;
    return step != IS_CONVERTED;
}

bool supply_is_at_rest(void)
{
    return step < SETTLES;
}

bool supply_end(uint16_t reading)
{
    if (step != IS_CONVERTED)
        return false;
    step = AT_REST;
    sei();
    rig_supply(reading ? (uint32_t)BANDGAP_MV * 1024 / reading : UINT16_MAX);
    cli();
    return true;
}
