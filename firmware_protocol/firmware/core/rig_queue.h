// The queue of setpoints in scheduled mode: one code for each sample index (PROTOCOL.md, section
// 6). All codes of a frame share one stored u_seq, so that a setpoint occupies 2 B and not 4 B.
//
// Main appends setpoints, and the interrupt removes the first setpoint. Main copies the codes with
// interrupts on. This is safe for two reasons: only main writes the places after the last setpoint,
// and the interrupt does not change the code in a place when it removes a setpoint.
#ifndef RIG_QUEUE_H
#define RIG_QUEUE_H

#include "../rig_protocol.h"
#include "board.h"

_Static_assert((BOARD_QUEUE & (BOARD_QUEUE - 1)) == 0, "an index is masked");
_Static_assert(BOARD_QUEUE >= 2 * RIG_SETPOINTS_PER_FRAME && BOARD_QUEUE <= RIG_QUEUE_CAPACITY, "queue");

enum { RIG_QUEUE_FRAMES = BOARD_QUEUE / 8 }; // most frames whose setpoints the queue may hold

struct rig_setpoint {
    uint16_t u;
    uint16_t seq; // of the frame that contained u; 0 for u_rest, which is in no frame
};

struct rig_queue {
    uint16_t codes[BOARD_QUEUE]; // main writes the places after the last; both read
    uint16_t frame_seqs[RIG_QUEUE_FRAMES]; // seq of each frame; access as for `codes`
    uint8_t frame_codes[RIG_QUEUE_FRAMES]; // setpoints of each frame in the queue; both change it
    uint32_t next; // index of the next sample to be latched; owner: interrupt
    uint16_t first, first_frame; // places of the next code and its frame; owner: interrupt
    uint16_t count, frames; // codes and frames held; main adds with interrupts off
    uint16_t dry; // successive samples without a setpoint, at most UINT8_MAX + 1; owner: interrupt
    bool wrapped; // `next` has wrapped at 2^32; owner: interrupt
    struct rig_setpoint in_force; // setpoint latched last, as the host sent it; owner: interrupt
};

enum rig_put {
    RIG_PUT, // accepted; setpoints that are late, follow a gap or have no room were dropped
    RIG_PUT_DISAGREES, // differs from an entry of the queue; the queue is unchanged
    RIG_PUT_OUT_OF_RANGE,
    RIG_PUT_TOO_STEEP,
};

// Initialises an empty queue: `next` is 0, and u_rest is in force. Called from main while no timer
// runs.
void rig_queue_begin(struct rig_queue *queue, uint16_t u_rest);

// Removes all setpoints. Called from main.
void rig_queue_empty(struct rig_queue *queue);

// Returns the number of setpoints in the queue. Called from main.
uint16_t rig_queue_count(const struct rig_queue *queue);

// Adds the setpoints of a frame that are new and in time. If the range or the slew is exceeded,
// `refused` is the first wrong code. Called from main.
enum rig_put rig_queue_put(
    struct rig_queue *queue, const rig_config_t *config, const rig_setpoints_t *m, uint16_t *refused);

// Removes the setpoint of `next` and puts it in force. Without a setpoint, applies the underrun
// policy and returns false. Called from an interrupt.
bool rig_queue_take(struct rig_queue *queue, const rig_config_t *config);

#endif
