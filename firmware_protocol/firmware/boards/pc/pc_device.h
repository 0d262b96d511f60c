// The emulated device's hardware around the core: clock, wires, converter and timer in virtual time.
// As daemon/armrig_daemon/emulator/device.py has it, to the nanosecond; the arm is somebody else's.
#ifndef PC_DEVICE_H
#define PC_DEVICE_H

#include <stdbool.h>
#include <stdint.h>

// What is outside the device: its pins, and who looks on. Times are given ones.
struct pc_world {
    uint16_t (*read)(int64_t t_ns, uint8_t channel); // 0 theta_1, 1 alpha
    void (*drive)(int64_t t_ns, uint16_t duty, uint16_t code);
    void (*release)(int64_t t_ns); // 0 V
    uint16_t (*supply)(int64_t t_ns);
    uint32_t (*token)(void);
    // Where the device is watched: what arrives, and what it came to where the state changed.
    void (*arrives)(int64_t t_ns, const uint8_t *bytes, uint32_t n);
    void (*changed)(int64_t t_ns, uint8_t before);
};

struct pc_setup {
    int64_t now_ns, reset_ns, second_ns, boot_ns, conversion_ns, hold_ns;
    uint32_t baud; // 0 is a wire that takes no time
    uint32_t boot_id;
    uint8_t reset_flags;
    uint8_t is_watched;
};

enum {
    PC_TX_BYTES = 256, // of the ring
    PC_RX_BYTES = 1 << 16, // on the wire at a time
    PC_MOST_PIECES = 1 << 12,
    PC_MOST_PENDING = 16,
};

// Bytes that end in 00, or the last ones given; they arrive together with the last.
struct pc_piece {
    int64_t end_ns;
    uint32_t n;
};

// A sample that waits for its conversions, or has them.
struct pc_pending {
    int64_t due_ns; // device time
    uint32_t k;
    uint16_t seq;
    bool is_timed;
};

struct pc_device {
    // What Python reads and sets by name and place: see `CoreState` in tests/firmware/library.py.
    int64_t next_ns, reset_ns, second_ns;
    struct {
        int64_t first_ns, period_ns, lead_ns, hold_ns, k_stop, k;
    } timer;
    uint32_t pending_k, pending_count; // of the sample that is latched first; all that wait
    uint16_t pending_seq;
    uint8_t is_timed, is_watched, is_booting, has_failed;

    int64_t conversion_ns, hold_ns, now_ns;
    uint32_t baud;
    int64_t booted_ns, status_ns, supply_ns, watchdog_ns, timer_ns, fed_ns;

    int64_t rx_free_ns, tx_free_ns;
    uint32_t rx_first, rx_count; // bytes
    uint32_t pieces_first, pieces_count;

    struct pc_pending pending[PC_MOST_PENDING];
    int64_t trigger_ns, due_ns, end_ns; // of what is converted
    uint32_t conversions, held;
    uint16_t cal_n;
    uint8_t cal_channel;
    bool is_latching; // the sample under way
    bool was_cut; // the motor was turned off since it was last looked at

    struct pc_piece pieces[PC_MOST_PIECES];
    uint8_t rx[PC_RX_BYTES];
};
extern struct pc_device pc_device;

void pc_device_connect(const struct pc_world *world);
void pc_device_begin(const struct pc_setup *setup);
void pc_device_receive(int64_t now_ns, const uint8_t *bytes, uint32_t n);

// Does what is due until `now_ns`, or up to the first frame; returns how many bytes of `pc_sent` are
// filled: of each frame its last byte's departure (8 B), its length (1 B), and itself. It may return
// before `now_ns`, as `pc_device.next_ns` tells.
uint32_t pc_device_advance(int64_t now_ns, bool to_frame);

// Returns until when the wire to the device is busy.
int64_t pc_device_busy_ns(void);

#endif
