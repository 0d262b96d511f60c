#include <stdbool.h>

#include "rig_status.h"

#include "rig_state.h" // rig
#include "rig_supply.h" // rig_supply_mv
#include "rig_transmission.h" // rig_send

#define STATUS_US 1000000UL

// Adds the whole milliseconds since the last call to the uptime.
static void count_uptime(uint32_t now_us)
{
    const uint32_t ms = (now_us - rig.uptime_us) / 1000;
    rig.uptime_ms += ms;
    rig.uptime_us += ms * 1000;
}

void rig_status_begin(void)
{
    const uint32_t now_us = board_now_us();
    rig.status_us = now_us < STATUS_US ? STATUS_US : now_us;
    count_uptime(now_us);
}

// Returns the number of samples without a setpoint, which the interrupt counts.
static uint16_t underruns(void)
{
    const uint8_t before = board_irq_save();
    const uint16_t n = rig.counters.underruns;
    board_irq_restore(before);
    return n;
}

void rig_tell_status(void)
{
    const uint32_t now_us = board_now_us();
    if ((int32_t)(now_us - rig.status_us) < 0)
        return;
    rig.status_us = now_us + STATUS_US;
    count_uptime(now_us);
    rig_status_t *m = &rig_blank()->status;
    m->boot = (uint16_t)rig.boot_id;
    m->vcc_mv = rig_supply_mv();
    m->uptime_ms = rig.uptime_ms;
    m->frames = rig.counters.frames;
    m->spoilt = rig.counters.spoilt;
    m->refused = rig.counters.refused;
    m->rx_lost = rig.counters.rx_lost;
    m->tx_dropped = rig.counters.tx_dropped;
    m->late = rig.counters.late;
    m->underruns = underruns();
    m->isr_max_us = board_isr_max_us();
    m->stack_free = board_stack_free();
    rig_send(RIG_TYPE_STATUS);
}

void rig_count_lost(uint16_t bytes)
{
    const uint16_t room = UINT16_MAX - rig.counters.rx_lost;
    rig.counters.rx_lost += bytes < room ? bytes : room;
    rig.new_flags |= RIG_FLAG_RX_OVERFLOW;
}
