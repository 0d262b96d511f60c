// What tests look at, or set, in the core's state; a device has none of it.
#include <string.h>

#include "../../core/rig_state.h"
#include "../../core/rig_sampling.h" // rig_tell_samples
#include "pc_board.h"

size_t pc_state_bytes(void) { return sizeof rig; }
void pc_save(uint8_t *to) { memcpy(to, &rig, sizeof rig); }
void pc_load(const uint8_t *from) { memcpy(&rig, from, sizeof rig); }

// Gives bytes to the core as they came.
void pc_receive(const uint8_t *bytes, uint16_t n)
{
    for (; n; n--)
        rig_receive(*bytes++);
}

// Ends a sample, and lets main tell it at once.
void pc_converted(uint8_t what, uint32_t t_us)
{
    rig_converted(what, t_us);
    rig_tell_samples();
}

// Ends the run, and lets main tell it at once.
void pc_end(void)
{
    rig_end();
    rig_tell_samples();
}

// Opens what came between two 00; `text` gets what was stuffed.
int pc_open(const uint8_t *stuffed, uint8_t n, uint8_t *text)
{
    union rig_frame frame = {0};
    memcpy(frame.wire, stuffed, n <= RIG_LONGEST_STUFFED ? n : RIG_LONGEST_STUFFED);
    const int opened = rig_open(&frame, n);
    memcpy(text, frame.message.bytes, RIG_MAX_DECODED);
    return opened;
}

// Closes a message of `length`; returns how many bytes `wire` has got.
uint8_t pc_close(const uint8_t *text, uint8_t length, uint8_t *wire)
{
    union rig_frame frame = {0};
    memcpy(frame.message.bytes, text, length);
    const uint8_t n = rig_close(&frame, length);
    memcpy(wire, frame.wire, n);
    return n;
}

uint32_t pc_frames(void) { return rig.counters.frames; }
uint32_t pc_spoilt(void) { return rig.counters.spoilt; }
uint16_t pc_rx_lost(void) { return rig.counters.rx_lost; }

uint8_t pc_state(void) { return rig.state; }
uint8_t pc_cause(void) { return rig.cause; }
uint32_t pc_fed_us(void) { return rig.fed_us; }
uint16_t pc_watchdog_ms(void) { return rig.config.watchdog_ms; }
uint32_t pc_ts_us(void) { return rig.config.ts_us; }
uint16_t pc_u_rest(void) { return rig.config.u_rest; }
uint16_t pc_u_seq(void) { return rig.motor.u_seq; }
uint16_t pc_u_in_force(void) { return rig.queue.in_force.u; }

// Returns the place of the EXCHANGE that came last.
static const struct rig_asked *last_asked(void)
{
    return &rig.asked[(rig.asked_first + rig.asked_count - 1) % RIG_MOST_ASKED];
}

uint32_t pc_asked_k(void) { return last_asked()->k; }
uint16_t pc_asked_seq(void) { return last_asked()->seq; }
uint16_t pc_asked_u(void) { return rig.asked[rig.asked_first].u; }

// Lets scheduled mode go on from sample `k`, as if so many had been taken.
void pc_set_next(uint32_t k)
{
    rig.queue.next = rig.timed_k = k;
}

uint32_t pc_next(void) { return rig.queue.next; }

// Makes this the boot of another id.
void pc_set_boot_id(uint32_t boot_id)
{
    rig.boot_id = rig.next_nonce = boot_id;
}

// Spoils the code that is to be latched next.
void pc_spoil_next(uint16_t u)
{
    rig.queue.codes[rig.queue.first] = u;
}
