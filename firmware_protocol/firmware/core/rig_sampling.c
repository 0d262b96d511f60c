#include "rig_sampling.h"

#include "rig_motor.h" // rig_motor_latch, rig_code
#include "rig_state.h" // rig
#include "rig_states.h" // rig_enter
#include "rig_supply.h" // rig_supply_is_low
#include "rig_transmission.h" // rig_send

void rig_ask(const rig_exchange_t *m, bool drives)
{
    const uint8_t before = board_irq_save();
    const uint8_t place = (rig.asked_first + rig.asked_count) % RIG_MOST_ASKED;
    rig.asked[place] = (struct rig_asked){.k = m->k, .u = m->u, .seq = m->seq, .drives = drives};
    rig.asked_count++;
    board_irq_restore(before);
    board_convert_now();
}

void rig_latch(uint8_t what)
{
    rig.motor.duty_before = rig.motor.duty;
    if (!(what & RIG_TIMED)) {
        const struct rig_asked *asked = &rig.asked[rig.asked_first];
        if (asked->drives)
            rig_motor_latch(asked->u, asked->seq);
    } else if (rig_is_timed() && rig.motor.live) {
        rig.ran_dry = !rig_queue_take(&rig.queue, &rig.config);
        if (rig.ran_dry && rig.counters.underruns < UINT16_MAX)
            rig.counters.underruns++;
        rig_motor_latch(rig.queue.in_force.u, rig.queue.in_force.seq);
    }
}

uint8_t rig_oversampling(void)
{
    const uint8_t m = rig.config.oversampling;
    return m ? m : 1; // m is 0 if no configuration is in force
}

void rig_reading(uint8_t channel, uint16_t code)
{
    if (rig.cal.is_under_way) {
        rig_cal_add(code);
        return;
    }
    struct rig_readings *readings = &rig.readings[channel];
    readings->sum += code;
    readings->last = code;
    readings->n++;
    readings->at_rail |= rig_at_rail(code);
}

// Returns the sum of a channel's readings, and clears it for the next sample. Called from an
// interrupt.
static struct rig_mean gathered(struct rig_readings *readings)
{
    struct rig_mean mean = {.sum = readings->sum, .n = readings->n};
    // A mean across the dead band would be an angle that the shaft never had.
    if (readings->at_rail)
        mean = (struct rig_mean){.sum = readings->last, .n = 1};
    *readings = (struct rig_readings){0};
    return mean;
}

// Returns the mean, a tie rounded up.
static uint16_t mean_of(const struct rig_mean *mean)
{
    return mean->n == 1 ? (uint16_t)mean->sum : (uint16_t)((mean->sum + mean->n / 2) / mean->n);
}

void rig_converted(uint8_t what, uint32_t t_us)
{
    uint32_t k;
    if (what & RIG_TIMED) {
        k = rig.timed_k++;
    } else {
        k = rig.asked[rig.asked_first].k;
        rig.asked_first = (rig.asked_first + 1) % RIG_MOST_ASKED;
        rig.asked_count--;
    }
    const struct rig_mean y0 = gathered(&rig.readings[0]), y1 = gathered(&rig.readings[1]);
    uint16_t flags = rig.ran_dry ? RIG_FLAG_UNDERRUN : 0;
    if (what & RIG_LATE)
        flags |= RIG_FLAG_TICK_LATE;
    rig.ran_dry = false;
    if (rig.taken_count == RIG_MOST_TAKEN) { // main is stalled: the sample is lost, k missing
        rig.taken_lost++;
        return;
    }
    rig.taken[(rig.taken_first + rig.taken_count) % RIG_MOST_TAKEN] = (struct rig_taken){
        .k = k,
        .t_us = t_us,
        .y = {y0, y1},
        .duty = rig.motor.duty,
        .duty_before = rig.motor.duty_before,
        .u_seq = rig.motor.u_seq,
        .flags = flags,
    };
    rig.taken_count++;
}

void rig_end(void)
{
    rig_motor_cut();
    rig.ended = true; // main then leaves RUN
}

// Returns the flags of SAMPLE for the present state and the last cause.
static uint16_t state_flags(void)
{
    switch (rig.state) {
    case RIG_STATE_RUN: return RIG_FLAG_RUN | RIG_FLAG_ARMED;
    case RIG_STATE_ARMED: return RIG_FLAG_ARMED;
    case RIG_STATE_ESTOP: return RIG_FLAG_ESTOP;
    case RIG_STATE_FAULT: break;
    default: return 0;
    }
    switch (rig.cause) {
    case RIG_CAUSE_WATCHDOG: return RIG_FLAG_WATCHDOG;
    case RIG_CAUSE_RANGE: return RIG_FLAG_RANGE;
    case RIG_CAUSE_SLEW: return RIG_FLAG_SLEW;
    case RIG_CAUSE_REV_LIMIT: return RIG_FLAG_REV_LIMIT;
    default: return 0;
    }
}

// Sends SAMPLE with the present state. Outside RUN u_k is 0, because the motor is at 0 V.
static void tell_sample(const struct rig_taken *taken, uint16_t y0, uint16_t y1)
{
    uint16_t flags = taken->flags | rig.new_flags | state_flags();
    flags |= rig_at_rail(y0) ? RIG_FLAG_ADC0_RAIL : 0;
    flags |= rig_at_rail(y1) ? RIG_FLAG_ADC1_RAIL : 0;
    flags |= rig_supply_is_low() ? RIG_FLAG_VCC_LOW : 0;
    rig.new_flags = 0;
    if (flags & RIG_FLAG_TICK_LATE && rig.counters.late < UINT16_MAX)
        rig.counters.late++;
    rig_sample_t *m = &rig_blank()->sample;
    m->boot = (uint16_t)rig.boot_id;
    m->echo = rig.newest;
    m->k = taken->k;
    m->t_us = taken->t_us;
    m->y0 = y0;
    m->y1 = y1;
    if (rig.state == RIG_STATE_RUN) {
        m->u_k = rig_code(taken->duty);
        m->u_seq = taken->u_seq;
    }
    m->u_km1 = rig_code(taken->duty_before);
    m->flags = flags;
    m->queued = rig_queue_count(&rig.queue);
    rig_send(RIG_TYPE_SAMPLE);
}

// In RUN, applies the guards to a sample. Sends the sample, and then the EVENT of a fault.
static void judge_and_tell(const struct rig_taken *taken)
{
    const uint16_t y0 = mean_of(&taken->y[0]), y1 = mean_of(&taken->y[1]);
    uint8_t cause = RIG_CAUSE_NONE;
    if (rig.state == RIG_STATE_RUN)
        cause = rig_watch(&rig.guards, y0, y1, rig.config.rail_ticks, rig.config.turns);
    if (cause != RIG_CAUSE_NONE)
        rig_enter(RIG_STATE_FAULT, cause, 0);
    tell_sample(taken, y0, y1);
    if (cause != RIG_CAUSE_NONE)
        rig_tell_transition();
}

// Counts the samples for which the interrupt had no room as frames not sent.
static void count_lost_samples(void)
{
    const uint8_t before = board_irq_save();
    const uint8_t lost = rig.taken_lost;
    rig.taken_lost = 0;
    board_irq_restore(before);
    if (lost) {
        rig.counters.tx_dropped =
            rig.counters.tx_dropped > UINT16_MAX - lost ? UINT16_MAX : rig.counters.tx_dropped + lost;
        rig.new_flags |= RIG_FLAG_TX_DROP;
    }
}

void rig_tell_samples(void)
{
    while (rig.taken_count) {
        judge_and_tell(&rig.taken[rig.taken_first]); // main owns it until the count falls
        const uint8_t before = board_irq_save();
        rig.taken_first = (rig.taken_first + 1) % RIG_MOST_TAKEN;
        rig.taken_count--;
        board_irq_restore(before);
    }
    count_lost_samples();
    if (rig.ended) {
        rig_enter(RIG_STATE_IDLE, RIG_CAUSE_END, 0);
        rig_tell_transition();
    }
}
