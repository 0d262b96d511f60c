// The queue of setpoints in scheduled mode: codes by sample index (PROTOCOL.md, section 6).
// The u_seq of a code is kept once for all codes that one frame brought: 2 B a setpoint, not 4.
//
// Main puts setpoints behind the last, the interrupt takes the first. Main so copies in pieces, with
// interrupts on: what lies behind the last is nobody else's, and what was taken stays as it was.
#ifndef RIG_QUEUE_H
#define RIG_QUEUE_H

#include "../rig_protocol.h"
#include "board.h"

_Static_assert((BOARD_QUEUE & (BOARD_QUEUE - 1)) == 0, "an index is masked");
_Static_assert(BOARD_QUEUE >= 2 * RIG_SETPOINTS_PER_FRAME && BOARD_QUEUE <= RIG_QUEUE_CAPACITY, "queue");

enum { RIG_QUEUE_FRAMES = BOARD_QUEUE / 8 }; // in which all that it holds may have come

struct rig_setpoint {
    uint16_t u;
    uint16_t seq; // of the frame that brought it; 0 where it is u_rest, which none brought
};

struct rig_queue {
    uint16_t codes[BOARD_QUEUE]; // written by main behind the last, read by both
    uint16_t frame_seqs[RIG_QUEUE_FRAMES]; // likewise
    uint8_t frame_codes[RIG_QUEUE_FRAMES]; // how many of its codes are left: likewise, then the interrupt's
    uint32_t next; // index of the next sample to be latched: the interrupt's
    uint16_t first, first_frame; // where its code and its frame are: the interrupt's
    uint16_t count, frames; // both add and take away, with interrupts off
    uint16_t dry; // samples in a row without a setpoint, at most UINT8_MAX + 1: the interrupt's
    bool wrapped; // `next` went beyond 2^32: the interrupt's
    struct rig_setpoint in_force; // what was latched last, as the host sent it: the interrupt's
};

enum rig_put {
    RIG_PUT, // what is too late, comes behind a gap, or finds no room was dropped
    RIG_PUT_DISAGREES, // with what is here; nothing changed
    RIG_PUT_OUT_OF_RANGE,
    RIG_PUT_TOO_STEEP,
};

// Begins empty, at sample 0, with u_rest before it. From main, while no timer runs.
void rig_queue_begin(struct rig_queue *queue, uint16_t u_rest);

// Empties it. From main.
void rig_queue_empty(struct rig_queue *queue);

// Returns how many samples from `next` on have their setpoint. From main.
uint16_t rig_queue_count(const struct rig_queue *queue);

// Takes in what is new and in time; `refused` is the code that was outside. From main.
enum rig_put rig_queue_put(
    struct rig_queue *queue, const rig_config_t *config, const rig_setpoints_t *m, uint16_t *refused);

// Puts the setpoint of `next` in force; returns whether there was one. From an interrupt.
bool rig_queue_take(struct rig_queue *queue, const rig_config_t *config);

#endif
