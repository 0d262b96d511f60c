#include "rig_transitions.h"

#include <string.h>

#include "rig_configuration.h" // rig_check_config
#include "rig_motor.h" // rig_motor_begin
#include "rig_state.h" // rig
#include "rig_states.h" // rig_enter
#include "rig_transmission.h" // rig_answer

// Makes a requested transition, and sends ACK and then EVENT.
static void follow(const union rig_message *m, uint8_t state)
{
    rig_enter(state, RIG_CAUSE_REQUEST, 0);
    rig_answer(&m->header, RIG_CODE_OK);
    rig_tell_transition();
}

// Puts a configuration in force, with a nonce that this boot has not used. The nonces count through
// 1 ... 2^32 - 1.
static void accept(const rig_config_t *m)
{
    rig.config = *m;
    rig.config_crc = rig_config_crc(m);
    rig.next_nonce = rig.next_nonce == UINT32_MAX ? 1 : rig.next_nonce + 1;
    rig.nonce = rig.next_nonce;
}

// Sends CONFIG_R with the configuration in force, or with zeros if there is none.
static void tell_config(uint8_t code)
{
    rig_config_r_t *m = &rig_blank()->config_r;
    m->code = code;
    m->config_crc = rig.config_crc;
    memcpy(&m->ts_us, &rig.config.ts_us, RIG_CONFIG_BODY);
    m->nonce = rig.nonce;
    rig_send(RIG_TYPE_CONFIG_R);
}

void rig_take_config(const rig_config_t *m)
{
    uint8_t code = RIG_CODE_WRONG_STATE;
    const bool is_idle = rig.state == RIG_STATE_IDLE;
    if (is_idle || rig.state == RIG_STATE_READY)
        code = rig_check_config(m);
    if (code != RIG_CODE_OK) {
        rig.counters.refused++;
        tell_config(code);
        return;
    }
    if (is_idle)
        rig_enter(RIG_STATE_READY, RIG_CAUSE_REQUEST, 0);
    accept(m);
    tell_config(code);
    if (is_idle)
        rig_tell_transition();
}

void rig_take_arm(const union rig_message *m)
{
    if (rig.state != RIG_STATE_READY || rig.cal.is_under_way) {
        rig_answer(&m->header, RIG_CODE_WRONG_STATE);
    } else if (m->arm.boot_id != rig.boot_id) {
        rig_answer(&m->header, RIG_CODE_WRONG_BOOT);
    } else if (m->arm.config_crc != rig.config_crc) {
        rig_answer(&m->header, RIG_CODE_WRONG_CONFIG);
    } else if (m->arm.nonce != rig.nonce) {
        rig_answer(&m->header, RIG_CODE_WRONG_NONCE);
    } else {
        rig_queue_begin(&rig.queue, rig.config.u_rest);
        follow(m, RIG_STATE_ARMED);
    }
}

void rig_take_start(const union rig_message *m)
{
    const bool is_scheduled = rig.config.mode == RIG_MODE_SCHEDULED;
    if (rig.state != RIG_STATE_ARMED) {
        rig_answer(&m->header, RIG_CODE_WRONG_STATE);
    } else if (m->start.nonce != rig.nonce) {
        rig_answer(&m->header, RIG_CODE_WRONG_NONCE);
    } else if (m->start.k_stop != 0 && !is_scheduled) {
        rig_answer(&m->header, RIG_CODE_BAD_VALUE);
    } else {
        const uint32_t now_us = board_now_us();
        rig.guards = (struct rig_guards){0};
        rig.u = rig.config.u_rest;
        rig.timed_k = 0;
        rig_enter(RIG_STATE_RUN, RIG_CAUSE_REQUEST, 0);
        rig_motor_begin(is_scheduled ? 0 : m->header.seq);
        if (is_scheduled)
            board_timer_start(now_us + rig.config.ts_us, rig.config.ts_us, m->start.k_stop);
        rig_answer(&m->header, RIG_CODE_OK);
        rig_tell_transition();
    }
}

// Returns true in FAULT and ESTOP, in which the motor is latched at 0 V.
static bool is_latched(void)
{
    return rig.state == RIG_STATE_FAULT || rig.state == RIG_STATE_ESTOP;
}

void rig_take_stop(const union rig_message *m)
{
    if (is_latched())
        rig_answer(&m->header, RIG_CODE_WRONG_STATE);
    else if (rig.state == RIG_STATE_IDLE)
        rig_answer(&m->header, RIG_CODE_OK);
    else
        follow(m, RIG_STATE_IDLE);
}

void rig_take_clear_fault(const union rig_message *m)
{
    if (!is_latched())
        rig_answer(&m->header, RIG_CODE_WRONG_STATE);
    else if (m->clear_fault.token != rig.token)
        rig_answer(&m->header, RIG_CODE_WRONG_TOKEN);
    else
        follow(m, RIG_STATE_IDLE);
}

void rig_take_estop(const union rig_message *m)
{
    if (rig.state == RIG_STATE_ESTOP)
        rig_answer(&m->header, RIG_CODE_OK);
    else
        follow(m, RIG_STATE_ESTOP);
}
