#include <stdbool.h>

#include "rig_requests.h"

#include "rig_cal.h" // rig_take_cal
#include "rig_sampling.h" // rig_ask
#include "rig_setpoints.h" // rig_take_setpoints
#include "rig_state.h" // rig
#include "rig_states.h" // rig_enter
#include "rig_transitions.h" // rig_take_config
#include "rig_transmission.h" // rig_answer

enum { LEAST_TYPE_OF_DEVICE = 0x80 };

// Returns true if `seq` is ahead of the newest seq by 1 ... 32767, modulo 2^16.
static bool is_newer(uint16_t seq)
{
    return !rig.has_newest || (int16_t)(seq - rig.newest) > 0;
}

// Returns true if `k` is ahead of the last EXCHANGE's k by 1 ... 2^31 - 1, modulo 2^32.
static bool is_ahead(uint32_t k)
{
    return !rig.has_k || (int32_t)(k - rig.k) > 0;
}

// Returns the cause of the fault if the u of `m` is wrong, or RIG_CAUSE_NONE.
static uint8_t fault_of(const rig_exchange_t *m)
{
    if (m->u < rig.config.u_min || m->u > rig.config.u_max)
        return RIG_CAUSE_RANGE;
    // The step counts from the last code as the host sent it. If it counted from the rounded duty,
    // an allowed ramp could trip.
    const uint16_t step = m->u > rig.u ? m->u - rig.u : rig.u - m->u;
    if (rig.config.slew && step > rig.config.slew)
        return RIG_CAUSE_SLEW;
    return RIG_CAUSE_NONE;
}

// Requests the sample of an EXCHANGE, which latches u in RUN.
static void take_exchange(const union rig_message *m)
{
    if (rig_is_timed() || rig.cal.is_under_way) {
        rig_answer(&m->header, RIG_CODE_WRONG_STATE);
        return;
    }
    if (!is_ahead(m->exchange.k)) {
        rig_answer(&m->header, RIG_CODE_STALE);
        return;
    }
    const bool drives = rig.state == RIG_STATE_RUN;
    if (drives) {
        const uint8_t cause = fault_of(&m->exchange);
        if (cause != RIG_CAUSE_NONE) {
            rig_enter(RIG_STATE_FAULT, cause, m->exchange.u);
            rig_tell_transition();
            return;
        }
        rig.u = m->exchange.u;
    }
    rig.k = m->exchange.k;
    rig.has_k = true;
    rig_ask(&m->exchange, drives);
}

// Sends HELLO_R.
static void take_hello(void)
{
    if (!rig_is_bound())
        rig.has_k = false;
    rig_hello_r_t *m = &rig_blank()->hello_r;
    m->version = RIG_VERSION;
    m->schema = RIG_SCHEMA_HASH;
    m->uid = board_uid();
    m->boot_id = rig.boot_id;
    m->firmware = board_firmware_crc();
    m->token = rig.token;
    m->ts_min_us = BOARD_TS_MIN_US;
    m->full_scale_mv = RIG_FULL_SCALE_MV;
    m->queue = BOARD_QUEUE;
    m->capabilities = BOARD_CAPABILITIES;
    m->skew_us = BOARD_SKEW_US;
    m->hold_us = BOARD_HOLD_US;
    m->adc_bits = BOARD_ADC_BITS;
    m->pwm_bits = BOARD_PWM_BITS;
    m->cause = rig.cause;
    m->reset = board_reset_flags();
    rig_send(RIG_TYPE_HELLO_R);
}

// Sends PONG with the device's clock.
static void take_ping(const rig_ping_t *ping)
{
    const uint32_t rx_us = board_now_us();
    rig_pong_t *m = &rig_blank()->pong;
    m->host_ns = ping->host_ns;
    m->rx_us = rx_us;
    m->tx_us = board_send_us();
    rig_send(RIG_TYPE_PONG);
}

// Makes the seq of a newer frame the newest seq and, except for HELLO, feeds the watchdog. Returns
// true if the frame must be executed.
static bool take_in(const struct rig_header *header)
{
    const bool is_hello = header->type == RIG_TYPE_HELLO;
    // In ARMED and RUN, a HELLO that is played again must not make old frames new.
    if ((is_hello && !rig_is_bound()) || is_newer(header->seq)) {
        rig.newest = header->seq;
        rig.has_newest = true;
        if (!is_hello) // HELLO asks for the identity and commands nothing
            rig.fed_us = board_now_us();
        return true;
    }
    return header->type == RIG_TYPE_STOP || header->type == RIG_TYPE_ESTOP;
}

void rig_refuse_unknown(const union rig_message *m)
{
    rig.counters.frames++;
    rig_answer(&m->header, RIG_CODE_UNKNOWN_TYPE);
}

void rig_take(const union rig_message *m)
{
    if (m->header.type >= LEAST_TYPE_OF_DEVICE) {
        rig_refuse_unknown(m);
        return;
    }
    rig.counters.frames++;
    if (!take_in(&m->header)) {
        rig_answer(&m->header, RIG_CODE_STALE);
        return;
    }
    switch (m->header.type) {
    case RIG_TYPE_HELLO: take_hello(); break;
    case RIG_TYPE_CONFIG: rig_take_config(&m->config); break;
    case RIG_TYPE_ARM: rig_take_arm(m); break;
    case RIG_TYPE_START: rig_take_start(m); break;
    case RIG_TYPE_STOP: rig_take_stop(m); break;
    case RIG_TYPE_CLEAR_FAULT: rig_take_clear_fault(m); break;
    case RIG_TYPE_ESTOP: rig_take_estop(m); break;
    case RIG_TYPE_EXCHANGE: take_exchange(m); break;
    case RIG_TYPE_SETPOINTS: rig_take_setpoints(m); break;
    case RIG_TYPE_PING: take_ping(&m->ping); break;
    case RIG_TYPE_KEEPALIVE: break;
    case RIG_TYPE_CAL: rig_take_cal(m); break;
    }
}
