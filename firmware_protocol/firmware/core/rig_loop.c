// The functions that the board's endless loop calls: rig_begin, rig_receive, rig_poll.
#include <string.h>

#include "rig_cal.h" // rig_tell_cal
#include "rig_requests.h" // rig_take
#include "rig_sampling.h" // rig_tell_samples
#include "rig_state.h" // rig
#include "rig_states.h" // rig_enter
#include "rig_status.h" // rig_tell_status
#include "rig_supply.h" // rig_watch_supply
#include "rig_transmission.h" // rig_send_break

struct rig rig;

void rig_begin(void)
{
    board_motor_off();
    memset(&rig, 0, sizeof rig);
    rig.state = RIG_STATE_BOOT;
    rig.boot_id = rig.next_nonce = board_boot_id(); // nonces count from boot_id
    rig_status_begin();
    rig_supply_begin();
    rig_enter(RIG_STATE_IDLE, RIG_CAUSE_POWER_ON, 0);
    rig_send_break();
    rig_tell_transition();
}

// Returns true if a valid frame is an EXCHANGE for which there is no place, because RIG_MOST_ASKED
// earlier EXCHANGEs still wait.
static bool is_one_too_many(const union rig_message *m)
{
    return m->header.type == RIG_TYPE_EXCHANGE && !rig_is_timed() && rig.asked_count == RIG_MOST_ASKED;
}

// Decodes the `n` bytes between two 00, and executes the frame.
static void take_frame(uint8_t n)
{
    switch (rig_open(&rig.rx, n)) {
    case RIG_SOUND:
        if (is_one_too_many(&rig.rx.message))
            rig_count_lost(sizeof(rig_exchange_t) + 2);
        else
            rig_take(&rig.rx.message);
        break;
    case RIG_UNKNOWN:
        rig_refuse_unknown(&rig.rx.message);
        break;
    default:
        rig.counters.spoilt++;
        rig.new_flags |= RIG_FLAG_CRC_ERR;
        break;
    }
}

void rig_receive(uint8_t byte)
{
    if (rig.state == RIG_STATE_BOOT)
        return;
    if (byte != 0) {
        if (rig.rx_bytes < RIG_LONGEST_STUFFED)
            rig.rx.wire[rig.rx_bytes] = byte;
        if (rig.rx_bytes <= RIG_LONGEST_STUFFED) // one byte more shows that the frame is too long
            rig.rx_bytes++;
        return;
    }
    if (rig.rx_bytes)
        take_frame(rig.rx_bytes);
    rig.rx_bytes = 0;
}

void rig_poll(void)
{
    const uint16_t lost = board_rx_lost();
    if (lost)
        rig_count_lost(lost);
    rig_watch_run();
    rig_tell_samples();
    rig_tell_cal();
    rig_watch_supply();
    rig_tell_status();
    board_feed_watchdog();
}
