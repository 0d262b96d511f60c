// All that the core remembers between calls. There is one, and no heap.
#ifndef RIG_STATE_H
#define RIG_STATE_H

#include "board.h"
#include "rig_cal.h"
#include "rig_frame.h"
#include "rig_guards.h"
#include "rig_queue.h"

enum {
    RIG_MOST_ASKED = 2, // EXCHANGE frames that wait for their samples
    RIG_MOST_TAKEN = 2, // samples that wait to be told
};

// An EXCHANGE that waits for its sample.
struct rig_asked {
    uint32_t k;
    uint16_t u, seq;
    bool drives; // u is to be latched: it was asked for in this RUN
};

// What has been read of one channel for the sample under way.
struct rig_readings {
    uint32_t sum;
    uint16_t last;
    uint8_t n;
    bool at_rail; // one of them
};

// A reading that is to be divided yet: an interrupt has no time for it.
struct rig_mean {
    uint32_t sum;
    uint8_t n;
};

// A sample that was taken and not told yet.
struct rig_taken {
    uint32_t k, t_us;
    struct rig_mean y[2]; // theta_1, alpha
    uint16_t duty, duty_before; // after the latch, at the end of the conversions; before the latch
    uint16_t u_seq;
    uint16_t flags;
};

// The motor, and who may drive it: `rig_motor.c` alone writes this.
struct rig_motor {
    volatile bool live; // in RUN, and nothing has cut it off
    volatile bool broken; // a code that no check lets through came as far as the pin
    uint16_t duty, duty_before; // what it has, 0 while it is off; what it had before the last latch
    uint16_t u_seq; // of the frame that the duty came from; 0 while it is off
};

// What STATUS tells, since boot; all but `underruns` are main's.
struct rig_counters {
    uint32_t frames, spoilt, refused;
    uint16_t rx_lost, tx_dropped, late;
    uint16_t underruns; // the interrupt's
};

// A transition, until its EVENT has been told.
struct rig_transition {
    uint8_t was, cause;
    uint32_t t_us;
    uint32_t detail;
};

struct rig {
    volatile uint8_t state; // main writes it with interrupts off, both read it
    uint8_t cause; // of the last transition; main's, as all that follows up to `asked`
    uint32_t boot_id, token;
    uint32_t nonce, next_nonce; // of the configuration in force, 0 where none is; of the next one
    uint32_t config_crc;
    bool has_newest, has_k;
    uint16_t newest; // seq of the newest frame taken in
    uint32_t k; // of the last EXCHANGE
    uint16_t u; // code last accepted in RUN of exchange mode, as the host sent it
    uint32_t fed_us; // when the last frame was taken in that feeds the watchdog
    uint16_t new_flags; // to be told once, in the next SAMPLE
    uint32_t status_us; // when STATUS is due
    uint32_t uptime_ms, uptime_us; // uptime up to uptime_us
    struct rig_transition transition;
    struct rig_guards guards;
    struct rig_counters counters;
    uint16_t tx_seq;
    union rig_frame tx; // one frame on its way to the board's ring
    uint8_t rx_bytes; // so many bytes have come since the last 00, at most one more than fit
    union rig_frame rx;

    // Both read it; main writes it while the motor is off and no timer runs.
    rig_config_t config; // in force; zeros where none is

    // Main puts behind the last, the interrupt takes the first; counts change with interrupts off.
    struct rig_asked asked[RIG_MOST_ASKED];
    uint8_t asked_first;
    volatile uint8_t asked_count;
    // The interrupt puts behind the last, main takes the first.
    struct rig_taken taken[RIG_MOST_TAKEN];
    uint8_t taken_first;
    volatile uint8_t taken_count;
    struct rig_readings readings[2]; // theta_1, alpha: the interrupt's
    struct rig_cal cal;
    uint8_t taken_lost; // for want of room, since main last looked
    uint32_t timed_k; // of the timer's next sample to be converted: the interrupt's while it runs
    bool ran_dry; // the sample under way had no setpoint: the interrupt's
    volatile bool ended; // the last input was held for its Ts: the interrupt sets it, main clears it

    uint16_t supply_mv; // as measured last, 0 where it is not; the interrupt's
    volatile bool is_measured; // the interrupt sets it, main clears it
    bool is_measuring; // asked for and not measured yet; main's
    uint32_t supply_us; // when it is to be asked for; main's

    struct rig_motor motor;
    struct rig_queue queue;
};
_Static_assert(sizeof(struct rig) <= BOARD_RAM, "the board grants the core so much RAM");

extern struct rig rig;

#endif
