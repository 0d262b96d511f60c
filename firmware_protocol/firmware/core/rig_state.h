// The state of the core between calls: one static structure, no heap.
#ifndef RIG_STATE_H
#define RIG_STATE_H

#include "board.h"
#include "rig_cal.h"
#include "rig_frame.h"
#include "rig_guards.h"
#include "rig_queue.h"

enum {
    RIG_MOST_ASKED = 2, // EXCHANGE frames that may wait for their samples
    RIG_MOST_TAKEN = 2, // samples that may wait to be sent
};

// An EXCHANGE that waits for its sample.
struct rig_asked {
    uint32_t k;
    uint16_t u, seq;
    bool drives; // the sample latches u: the EXCHANGE came in the present RUN
};

// The readings of one channel for the sample in progress.
struct rig_readings {
    uint32_t sum;
    uint16_t last;
    uint8_t n;
    bool at_rail; // at least one of the readings is at a rail
};

// A sum of readings. Main divides it, because the interrupt has no time for a division.
struct rig_mean {
    uint32_t sum;
    uint8_t n;
};

// A complete sample that was not sent yet.
struct rig_taken {
    uint32_t k, t_us;
    struct rig_mean y[2]; // by channel
    uint16_t duty, duty_before; // at the end of the conversions; before the latch
    uint16_t u_seq;
    uint16_t flags;
};

// The motor and the permission to drive it. Only `rig_motor.c` permits driving and sets a duty.
struct rig_motor {
    volatile bool live; // driving is permitted: from rig_motor_begin to rig_motor_cut
    volatile bool broken; // a code outside the limits reached the last check before the pin
    uint16_t duty, duty_before; // present duty, 0 while off; duty before the last latch
    uint16_t u_seq; // seq of the frame that contained the code; 0 while off
};

// Counters of STATUS since boot. Main counts all except `underruns`.
struct rig_counters {
    uint32_t frames, spoilt, refused;
    uint16_t rx_lost, tx_dropped, late;
    uint16_t underruns; // owner: interrupt
};

// The latest transition, for its EVENT.
struct rig_transition {
    uint8_t was, cause;
    uint32_t t_us;
    uint32_t detail;
};

struct rig {
    volatile uint8_t state; // main writes it with interrupts off; both read it
    uint8_t cause; // of the latest transition; main owns all fields up to `config`
    uint32_t boot_id, token;
    uint32_t nonce, next_nonce; // of the configuration in force, 0 if none; last nonce drawn
    uint32_t config_crc;
    bool has_newest, has_k;
    uint16_t newest; // seq of the newest frame taken in (PROTOCOL.md, section 2)
    uint32_t k; // k of the last accepted EXCHANGE
    uint16_t u; // code last accepted in RUN of exchange mode, as the host sent it; at first u_rest
    uint32_t fed_us; // device time at which a frame last fed the watchdog
    uint16_t new_flags; // flags to report once, in the next SAMPLE
    uint32_t status_us; // device time at which STATUS is due
    uint32_t uptime_ms, uptime_us; // uptime until the device time uptime_us
    struct rig_transition transition;
    struct rig_guards guards;
    struct rig_counters counters;
    uint16_t tx_seq;
    union rig_frame tx; // the frame to be sent, until the board has copied it
    uint8_t rx_bytes; // bytes since the last 00; the count ends one above RIG_LONGEST_STUFFED
    union rig_frame rx;

    // Both contexts read the configuration. Main writes it while the motor is off and no timer
    // runs.
    rig_config_t config; // in force; zeros if there is none

    // EXCHANGE frames that wait for their samples. Main appends, and the interrupt removes the
    // first. Main changes the count with interrupts off.
    struct rig_asked asked[RIG_MOST_ASKED];
    uint8_t asked_first;
    volatile uint8_t asked_count;
    // Samples that wait to be sent. The interrupt appends, and main removes the first.
    struct rig_taken taken[RIG_MOST_TAKEN];
    uint8_t taken_first;
    volatile uint8_t taken_count;
    struct rig_readings readings[2]; // by channel; owner: interrupt
    struct rig_cal cal;
    uint8_t taken_lost; // samples lost for lack of room since main last cleared the count
    uint32_t timed_k; // k of the timer's next sample; owner: interrupt while the timer runs
    bool ran_dry; // the sample in progress had no setpoint; owner: interrupt
    volatile bool ended; // the run has ended; the interrupt sets it, main clears it

    uint16_t supply_mv; // last measured supply, 0 if never measured; owner: interrupt
    volatile bool is_measured; // a measurement is complete; the interrupt sets it, main clears it
    bool is_measuring; // a measurement was requested and is not complete; owner: main
    uint32_t supply_us; // device time of the next measurement; owner: main

    struct rig_motor motor;
    struct rig_queue queue;
};
_Static_assert(sizeof(struct rig) <= BOARD_RAM, "the board grants the core so much RAM");

extern struct rig rig;

#endif
