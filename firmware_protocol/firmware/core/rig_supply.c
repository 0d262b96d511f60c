#include "rig_supply.h"

#include "rig_state.h" // rig
#include "rig_states.h" // rig_enter

#define SUPPLY_US 100000UL
enum { LOW_MV = 4000 };

void rig_supply(uint16_t mv)
{
    rig.supply_mv = mv;
    rig.is_measured = true;
}

uint16_t rig_supply_mv(void)
{
    const uint8_t before = board_irq_save();
    const uint16_t mv = rig.supply_mv;
    board_irq_restore(before);
    return mv;
}

bool rig_supply_is_low(void)
{
    const uint16_t mv = rig_supply_mv();
    return mv != 0 && mv < LOW_MV;
}

// Requests one measurement. A board that cannot measure the supply never answers, so that no second
// request follows.
static void ask(void)
{
    rig.is_measuring = true;
    board_measure_supply();
}

// Schedules the next measurement. In ARMED and RUN, trips if the present measurement is too low.
static void judge(void)
{
    rig.is_measured = rig.is_measuring = false;
    rig.supply_us = board_now_us() + SUPPLY_US;
    if (rig_supply_is_low() && rig_is_bound()) {
        rig_enter(RIG_STATE_FAULT, RIG_CAUSE_VCC_LOW, rig_supply_mv());
        rig_tell_transition();
    }
}

void rig_supply_begin(void)
{
    ask();
    if (rig.is_measured)
        judge();
}

void rig_watch_supply(void)
{
    if (!rig.is_measuring && (int32_t)(board_now_us() - rig.supply_us) >= 0)
        ask();
    if (rig.is_measured)
        judge();
}
