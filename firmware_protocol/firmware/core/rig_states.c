#include "rig_states.h"

#include "rig_motor.h" // rig_motor_cut
#include "rig_state.h" // rig
#include "rig_transmission.h" // rig_send

// Called at the end of a RUN: its waiting EXCHANGEs no longer latch u. Interrupts are off.
static void disown_asked(void)
{
    for (uint8_t i = 0; i < RIG_MOST_ASKED; i++)
        rig.asked[i].drives = false;
}

// Clears the configuration, so that none is in force.
static void forget_config(void)
{
    rig.config = (rig_config_t){0};
    rig.config_crc = rig.nonce = 0;
}

void rig_enter(uint8_t state, uint8_t cause, uint32_t detail)
{
    if (state != RIG_STATE_RUN)
        rig_motor_cut();
    const uint8_t before = board_irq_save();
    const uint8_t was = rig.state;
    rig.state = state;
    if (was == RIG_STATE_RUN)
        disown_asked();
    board_irq_restore(before);
    if (state != RIG_STATE_RUN) {
        board_timer_stop();
        rig.ended = false;
        if (state != RIG_STATE_ARMED)
            rig_queue_empty(&rig.queue);
    }
    rig.cause = cause;
    rig.token = state == RIG_STATE_FAULT || state == RIG_STATE_ESTOP ? board_token() : 0;
    if (state == RIG_STATE_IDLE)
        forget_config();
    rig.transition = (struct rig_transition){
        .was = was, .cause = cause, .t_us = board_now_us(), .detail = detail};
}

void rig_tell_transition(void)
{
    rig_event_t *m = &rig_blank()->event;
    m->boot = (uint16_t)rig.boot_id;
    m->was = rig.transition.was;
    m->cause = rig.transition.cause;
    m->t_us = rig.transition.t_us;
    m->token = rig.token;
    m->detail = rig.transition.detail;
    rig_send(RIG_TYPE_EVENT);
}

bool rig_is_bound(void)
{
    return rig.state == RIG_STATE_ARMED || rig.state == RIG_STATE_RUN;
}

bool rig_is_timed(void)
{
    return rig.state == RIG_STATE_RUN && rig.config.mode == RIG_MODE_SCHEDULED;
}

// Makes a transition without a request, and sends its EVENT.
static void trip(uint8_t state, uint8_t cause)
{
    rig_enter(state, cause, 0);
    rig_tell_transition();
}

void rig_watch_run(void)
{
    if (rig.motor.broken) {
        rig.motor.broken = false;
        if (rig.state == RIG_STATE_RUN)
            trip(RIG_STATE_FAULT, RIG_CAUSE_INTERNAL);
    }
    if (rig_is_bound() && board_now_us() - rig.fed_us >= rig.config.watchdog_ms * 1000UL)
        trip(RIG_STATE_FAULT, RIG_CAUSE_WATCHDOG);
}
