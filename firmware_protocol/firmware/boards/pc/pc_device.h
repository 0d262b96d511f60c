// The hardware of the emulated device around the core: clock, wires, converter and timer in virtual
// time. To the nanosecond, it behaves like daemon/armrig_daemon/emulator/device.py. The arm is not
// part of it.
#ifndef PC_DEVICE_H
#define PC_DEVICE_H

#include <stdbool.h>
#include <stdint.h>

// What the device is connected to: its pins, and an observer. All times are virtual times, not
// times of the device's clock.
struct pc_world {
    uint16_t (*read)(int64_t t_ns, uint8_t channel); // 0 or 1
    void (*drive)(int64_t t_ns, uint16_t duty, uint16_t code);
    void (*release)(int64_t t_ns); // the motor is at 0 V
    uint16_t (*supply)(int64_t t_ns);
    uint32_t (*token)(void);
    // Only if `is_watched`: bytes have arrived; bytes that arrived have changed the state.
    void (*arrives)(int64_t t_ns, const uint8_t *bytes, uint32_t n);
    void (*changed)(int64_t t_ns, uint8_t before);
};

struct pc_setup {
    int64_t now_ns, reset_ns, second_ns, boot_ns, conversion_ns, hold_ns;
    uint32_t baud; // 0: a byte takes no time
    uint32_t boot_id;
    uint8_t reset_flags;
    uint8_t is_watched;
};

enum {
    PC_TX_BYTES = 256, // capacity of the transmit ring
    PC_RX_BYTES = 1 << 16, // most bytes on the wire to the device
    PC_MOST_PIECES = 1 << 12,
    PC_MOST_PENDING = 16,
};

// Bytes on the wire up to a 00, or the rest of the bytes of a call. They arrive together with their
// last byte.
struct pc_piece {
    int64_t end_ns;
    uint32_t n;
};

// A sample that waits for its conversions or is being converted.
struct pc_pending {
    int64_t due_ns; // device time of the first trigger
    uint32_t k;
    uint16_t seq;
    bool is_timed;
};

struct pc_device {
    // Python reads and sets these fields through `CoreState` in tests/firmware/library.py, which
    // must have the same layout.
    int64_t next_ns, reset_ns, second_ns;
    struct {
        int64_t first_ns, period_ns, lead_ns, hold_ns, k_stop, k;
    } timer;
    uint32_t pending_k, pending_count; // k of the first pending sample; number of them
    uint16_t pending_seq;
    uint8_t is_timed, is_watched, is_booting, has_failed;

    int64_t conversion_ns, hold_ns, now_ns;
    uint32_t baud;
    int64_t booted_ns, status_ns, supply_ns, watchdog_ns, timer_ns, fed_ns;

    int64_t rx_free_ns, tx_free_ns;
    uint32_t rx_first, rx_count; // first byte in the ring; number of bytes
    uint32_t pieces_first, pieces_count;

    struct pc_pending pending[PC_MOST_PENDING];
    int64_t trigger_ns, due_ns, end_ns; // first trigger (device time), next hold, last end
    uint32_t conversions, held;
    uint16_t cal_n;
    uint8_t cal_channel;
    bool is_latching; // rig_latch of the first pending sample is being called
    bool was_cut; // the motor was turned off since the last `settle`

    struct pc_piece pieces[PC_MOST_PIECES];
    uint8_t rx[PC_RX_BYTES];
};
extern struct pc_device pc_device;

void pc_device_connect(const struct pc_world *world);
void pc_device_begin(const struct pc_setup *setup);
void pc_device_receive(int64_t now_ns, const uint8_t *bytes, uint32_t n);

// Executes the events that are due until `now_ns`, or up to the first frame to the host. Returns
// the number of bytes written to `pc_sent`. For each frame these are the time at which its last
// byte leaves (8 B), its length (1 B), and its bytes. The function may return before `now_ns`;
// `pc_device.next_ns` is then the time of the next event.
uint32_t pc_device_advance(int64_t now_ns, bool to_frame);

// Returns the time until which the wire to the device is busy.
int64_t pc_device_busy_ns(void);

#endif
