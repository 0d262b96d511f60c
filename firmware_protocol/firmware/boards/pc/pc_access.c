// Access of tests to the core's state; a device has none of these functions.
#include <string.h>

#include "../../core/rig_state.h"
#include "../../core/rig_sampling.h" // rig_tell_samples
#include "pc_board.h"
#include "pc_device.h"

// Copies `n` bytes of `state` to `image` if `out` is true, otherwise from it. Returns the end of
// the copied bytes in `image`.
static uint8_t *moved(uint8_t *image, void *state, size_t n, bool out)
{
    memcpy(out ? (void *)image : state, out ? state : (void *)image, n);
    return image + n;
}

// Copies the whole device to `image` if `out` is true, otherwise from it. Returns its size.
size_t pc_move(uint8_t *image, bool out)
{
    uint8_t *end = moved(image, &rig, sizeof rig, out);
    end = moved(end, &pc_board, sizeof pc_board, out);
    return (size_t)(moved(end, &pc_device, sizeof pc_device, out) - image);
}

size_t pc_bytes(void) { return sizeof rig + sizeof pc_board + sizeof pc_device; }

// Passes bytes to the core in their order.
void pc_receive(const uint8_t *bytes, uint16_t n)
{
    for (; n; n--)
        rig_receive(*bytes++);
}

// Decodes the bytes between two 00. Writes the message to `text`, and returns the result of
// rig_open.
int pc_open(const uint8_t *stuffed, uint8_t n, uint8_t *text)
{
    union rig_frame frame = {0};
    memcpy(frame.wire, stuffed, n <= RIG_LONGEST_STUFFED ? n : RIG_LONGEST_STUFFED);
    const int opened = rig_open(&frame, n);
    memcpy(text, frame.message.bytes, RIG_MAX_DECODED);
    return opened;
}

// Encodes a message of `length` bytes. Returns the number of bytes written to `wire`.
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
uint16_t pc_tx_dropped(void) { return rig.counters.tx_dropped; }
uint16_t pc_rx_lost(void) { return rig.counters.rx_lost; }

uint8_t pc_state(void) { return rig.state; }
uint8_t pc_cause(void) { return rig.cause; }
uint16_t pc_u_seq(void) { return rig.motor.u_seq; }

// Continues scheduled mode at sample `k`, as if `k` samples had been taken.
void pc_set_next(uint32_t k)
{
    rig.queue.next = rig.timed_k = k;
}

uint32_t pc_next(void) { return rig.queue.next; }

// Changes the boot_id of the present boot.
void pc_set_boot_id(uint32_t boot_id)
{
    rig.boot_id = rig.next_nonce = boot_id;
}

// Overwrites the code that will be latched next.
void pc_spoil_next(uint16_t u)
{
    rig.queue.codes[rig.queue.first] = u;
}
