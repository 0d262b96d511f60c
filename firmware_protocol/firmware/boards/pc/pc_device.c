#include "pc_device.h"

#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "../../core/rig_cal.h" // rig_tell_cal
#include "../../core/rig_sampling.h" // rig_tell_samples
#include "../../core/rig_state.h" // rig
#include "../../core/rig_states.h" // rig_watch_run
#include "../../core/rig_status.h" // rig_tell_status
#include "../../core/rig_supply.h" // rig_watch_supply
#include "pc_board.h"

#define NEVER ((int64_t)1 << 62)
#define BILLION 1000000000LL

enum {
    SENT_BYTES = 1 << 14,
    BITS_PER_BYTE = 10,
};

struct pc_device pc_device;
uint8_t pc_sent[SENT_BYTES];
static uint32_t sent_bytes;
static struct pc_world world;

// Returns a / b, rounded down; b is positive.
static int64_t quotient(__int128 a, int64_t b)
{
    const __int128 q = a / b;
    return (int64_t)(q - (a % b < 0));
}

// Returns the time of the device's clock at a virtual time.
static int64_t device_ns(int64_t now_ns)
{
    return quotient((__int128)(now_ns - pc_device.reset_ns) * BILLION, pc_device.second_ns);
}

// Returns the first virtual time, in ns, at which the device's clock shows `ns`.
static int64_t instant(int64_t ns)
{
    return pc_device.reset_ns - quotient((__int128)-ns * pc_device.second_ns, BILLION);
}

// Returns the virtual time at which `dt_ns` of device time will have passed since `now_ns`.
static int64_t after(int64_t now_ns, int64_t dt_ns)
{
    return instant(device_ns(now_ns) + dt_ns);
}

static uint32_t device_us(int64_t now_ns)
{
    return (uint32_t)(device_ns(now_ns) / 1000);
}

// Returns the time that `n` bytes take on a wire.
static int64_t wire_ns(uint32_t n)
{
    return pc_device.baud ? n * BITS_PER_BYTE * BILLION / pc_device.baud : 0;
}

static int64_t later(int64_t a, int64_t b)
{
    return a > b ? a : b;
}

// ------------------------------------------------------------- the wire to the device

void pc_device_receive(int64_t now_ns, const uint8_t *bytes, uint32_t n)
{
    struct pc_device *d = &pc_device;
    const int64_t start_ns = later(d->rx_free_ns, now_ns);
    for (uint32_t begin = 0, end; begin < n; begin = end) {
        const uint8_t *zero = memchr(bytes + begin, 0, n - begin);
        end = zero ? (uint32_t)(zero - bytes) + 1 : n;
        if (d->pieces_count == PC_MOST_PIECES || d->rx_count + end - begin > PC_RX_BYTES)
            abort(); // no host sends so many bytes ahead
        const struct pc_piece piece = {.end_ns = start_ns + wire_ns(end), .n = end - begin};
        d->pieces[(d->pieces_first + d->pieces_count++) % PC_MOST_PIECES] = piece;
        for (; begin < end; begin++)
            d->rx[(d->rx_first + d->rx_count++) % PC_RX_BYTES] = bytes[begin];
        d->rx_free_ns = piece.end_ns;
        if (d->pieces[d->pieces_first].end_ns < d->next_ns)
            d->next_ns = d->pieces[d->pieces_first].end_ns;
    }
}

int64_t pc_device_busy_ns(void)
{
    return pc_device.rx_free_ns;
}

static int64_t rx_first_ns(void)
{
    return pc_device.pieces_count ? pc_device.pieces[pc_device.pieces_first].end_ns : NEVER;
}

// Moves the first `n` bytes on the wire to `to`.
static void take_off(uint8_t *to, uint32_t n)
{
    struct pc_device *d = &pc_device;
    for (uint32_t i = 0; i < n; i++)
        to[i] = d->rx[(d->rx_first + i) % PC_RX_BYTES];
    d->rx_first = (d->rx_first + n) % PC_RX_BYTES;
    d->rx_count -= n;
}

// Discards the bytes that have arrived of a piece that is still on the wire.
static void forget(int64_t now_ns)
{
    struct pc_device *d = &pc_device;
    const int64_t byte_ns = wire_ns(1);
    if (d->pieces_count == 0 || byte_ns == 0)
        return;
    struct pc_piece *piece = &d->pieces[d->pieces_first];
    const int64_t left = -quotient(now_ns - piece->end_ns, byte_ns);
    if (left < piece->n) {
        static uint8_t lost[PC_RX_BYTES];
        take_off(lost, piece->n - (uint32_t)left);
        piece->n = (uint32_t)left;
    }
}

// ------------------------------------------------------------- functions of the board for the core

static void motor_off(void)
{
    pc_device.was_cut = true;
}

// Returns the code that is being latched, as the host sent it.
static uint16_t latched_code(void)
{
    const struct pc_device *d = &pc_device;
    if (!d->is_latching)
        return rig.config.u_rest; // RUN begins with u_rest
    return d->pending[0].is_timed ? rig.queue.in_force.u : rig.asked[rig.asked_first].u;
}

static void motor_set(uint16_t duty)
{
    world.drive(pc_device.now_ns, duty, latched_code());
}

static void put_pending(int64_t due_ns, uint32_t k, uint16_t seq, bool is_timed)
{
    struct pc_device *d = &pc_device;
    if (d->pending_count == PC_MOST_PENDING)
        abort();
    d->pending[d->pending_count++] =
        (struct pc_pending){.due_ns = due_ns, .k = k, .seq = seq, .is_timed = is_timed};
}

static void convert_now(void)
{
    const struct rig_asked *asked =
        &rig.asked[(rig.asked_first + rig.asked_count - 1) % RIG_MOST_ASKED];
    put_pending(device_ns(pc_device.now_ns), asked->k, asked->seq, false);
}

// Schedules the timer's next event: the first conversion of a sample, or the end of the run.
static void plan_timer(void)
{
    struct pc_device *d = &pc_device;
    d->timer_ns = NEVER;
    if (!d->is_timed)
        return;
    const int64_t tick_ns = d->timer.first_ns + d->timer.k * d->timer.period_ns;
    const bool ends = d->timer.k_stop && d->timer.k >= d->timer.k_stop;
    d->timer_ns = instant(ends ? tick_ns + d->timer.hold_ns : tick_ns - d->timer.lead_ns);
}

static void timer_start(uint32_t t0_us, uint32_t ts_us, uint32_t k_stop)
{
    struct pc_device *d = &pc_device;
    (void)t0_us; // in whole microseconds; first_ns is exact to the nanosecond
    d->timer.period_ns = ts_us * 1000LL;
    d->timer.first_ns = device_ns(d->now_ns) + d->timer.period_ns;
    d->timer.lead_ns = (2 * rig_oversampling() - 1) * d->conversion_ns;
    d->timer.hold_ns = d->hold_ns;
    d->timer.k_stop = k_stop;
    d->timer.k = 0;
    d->is_timed = true;
    plan_timer();
}

static void timer_stop(void)
{
    pc_device.is_timed = false;
    pc_device.timer_ns = NEVER;
}

static bool converter_is_free(void)
{
    return pc_device.pending_count == 0 && pc_device.conversions == 0;
}

static void convert_channel(uint8_t channel, uint16_t n)
{
    pc_device.cal_channel = channel;
    pc_device.cal_n = n;
}

static void measure_supply(void)
{
    rig_supply(world.supply(pc_device.now_ns));
}

static bool send(const uint8_t *bytes, uint8_t n)
{
    struct pc_device *d = &pc_device;
    const int64_t end_ns = later(d->tx_free_ns, d->now_ns) + wire_ns(n);
    if (end_ns - d->now_ns > wire_ns(PC_TX_BYTES))
        return false;
    d->tx_free_ns = end_ns;
    memcpy(pc_sent + sent_bytes, &end_ns, sizeof end_ns);
    pc_sent[sent_bytes + sizeof end_ns] = n;
    memcpy(pc_sent + sent_bytes + sizeof end_ns + 1, bytes, n);
    sent_bytes += sizeof end_ns + 1 + n;
    return true;
}

static uint32_t send_us(void)
{
    return device_us(later(pc_device.now_ns, pc_device.tx_free_ns));
}

static uint32_t token(void)
{
    return world.token();
}

// ------------------------------------------------------------- converter

// Starts the first conversion, and schedules the others.
static void trigger(int64_t due_ns, uint32_t conversions)
{
    struct pc_device *d = &pc_device;
    d->trigger_ns = due_ns;
    d->pending_k = d->pending[0].k;
    d->pending_seq = d->pending[0].seq;
    d->conversions = conversions;
    d->held = 0;
    d->end_ns = instant(due_ns + conversions * d->conversion_ns);
    d->due_ns = instant(due_ns + d->hold_ns);
}

// Starts the first pending sample, or the pending CAL, unless a conversion is in progress.
static void wake(void)
{
    struct pc_device *d = &pc_device;
    if (d->conversions)
        return;
    if (d->pending_count)
        trigger(d->pending[0].due_ns, 2U * rig_oversampling());
    else if (d->cal_n)
        trigger(device_ns(d->now_ns), d->cal_n);
}

// Ends the sample or the CAL in progress. After a sample, starts the next pending sample.
static void end_conversions(void)
{
    struct pc_device *d = &pc_device;
    const int64_t end_ns = d->trigger_ns + d->conversions * d->conversion_ns;
    d->conversions = 0;
    d->due_ns = d->end_ns = NEVER;
    if (d->cal_n) {
        d->cal_n = 0;
        rig_tell_cal();
        return;
    }
    uint8_t what = d->pending[0].is_timed ? RIG_TIMED : RIG_ASKED;
    if (d->trigger_ns > d->pending[0].due_ns)
        what |= RIG_LATE;
    d->pending_count--;
    memmove(d->pending, d->pending + 1, d->pending_count * sizeof *d->pending);
    rig_converted(what, (uint32_t)((end_ns - d->conversion_ns) / 1000));
    rig_tell_samples();
    if (d->pending_count)
        trigger(later(end_ns, d->pending[0].due_ns), 2U * rig_oversampling());
}

// Holds the next input. After the last hold of channel 0, latches u. After the last conversion, ends
// the sample.
static void step_converter(int64_t t_ns)
{
    struct pc_device *d = &pc_device;
    if (d->held == d->conversions) {
        end_conversions();
        return;
    }
    const uint8_t channel = d->cal_n ? d->cal_channel : 1 - (d->held & 1);
    rig_reading(channel, world.read(t_ns, channel));
    d->held++;
    if (d->held < d->conversions) {
        d->due_ns = instant(d->trigger_ns + d->held * d->conversion_ns + d->hold_ns);
        return;
    }
    if (!d->cal_n) {
        d->is_latching = true;
        rig_latch(d->pending[0].is_timed ? RIG_TIMED : RIG_ASKED);
        d->is_latching = false;
    }
    d->due_ns = d->end_ns;
}

// ------------------------------------------------------------- the device

void pc_device_connect(const struct pc_world *connected)
{
    world = *connected;
}

void pc_device_begin(const struct pc_setup *setup)
{
    static const struct pc_hardware hardware = {motor_off, motor_set, convert_now, timer_start,
        timer_stop, converter_is_free, convert_channel, measure_supply, send, send_us, token};
    struct pc_device *d = &pc_device;
    memset(d, 0, offsetof(struct pc_device, pieces)); // the bytes on the wires are lost
    d->is_watched = setup->is_watched;
    d->is_booting = true;
    d->reset_ns = setup->reset_ns;
    d->second_ns = setup->second_ns;
    d->conversion_ns = setup->conversion_ns;
    d->hold_ns = setup->hold_ns;
    d->baud = setup->baud;
    d->rx_free_ns = d->tx_free_ns = setup->now_ns;
    d->watchdog_ns = d->timer_ns = d->supply_ns = d->due_ns = d->end_ns = NEVER;
    d->booted_ns = after(setup->now_ns, setup->boot_ns);
    d->status_ns = after(setup->now_ns, later(BILLION, setup->boot_ns + 1));
    d->next_ns = d->booted_ns;
    pc_plug(&hardware);
    pc_reset(setup->boot_id, setup->reset_flags);
}

// Turns the emulated pin off if the core has turned the motor off.
static void settle(int64_t t_ns)
{
    if (pc_device.was_cut) {
        pc_device.was_cut = false;
        world.release(t_ns);
    }
}

// Passes the bytes of the piece that has arrived to the core.
static void arrive(int64_t t_ns)
{
    static uint8_t bytes[PC_RX_BYTES];
    struct pc_device *d = &pc_device;
    const uint32_t n = d->pieces[d->pieces_first].n;
    d->pieces_first = (d->pieces_first + 1) % PC_MOST_PIECES;
    d->pieces_count--;
    take_off(bytes, n);
    if (d->is_booting)
        return;
    const uint8_t before = rig.state;
    if (d->is_watched)
        world.arrives(t_ns, bytes, n);
    for (uint32_t i = 0; i < n; i++)
        rig_receive(bytes[i]);
    wake();
    settle(t_ns);
    if (d->is_watched && rig.state != before)
        world.changed(t_ns, before);
}

// Makes the timer's next sample pending, or ends the run.
static void tick(void)
{
    struct pc_device *d = &pc_device;
    if (d->timer.k_stop && d->timer.k >= d->timer.k_stop) {
        timer_stop();
        rig_end();
        rig_tell_samples();
        return;
    }
    const int64_t due_ns = d->timer.first_ns + d->timer.k * d->timer.period_ns - d->timer.lead_ns;
    put_pending(due_ns, (uint32_t)d->timer.k, 0, true);
    d->timer.k++;
    plan_timer();
    wake();
}

// Schedules the time at which the watchdog trips.
static void plan_watchdog(int64_t t_ns)
{
    struct pc_device *d = &pc_device;
    d->watchdog_ns = NEVER;
    if (!d->is_booting && rig_is_bound()) {
        // The core stores this time in microseconds; fed_ns is exact to the nanosecond.
        if (rig.fed_us == device_us(t_ns))
            d->fed_ns = t_ns;
        d->watchdog_ns = after(d->fed_ns, rig.config.watchdog_ms * 1000000LL);
    }
}

// Executes one event that is due. Received bytes precede the other events, so that a STOP precedes
// a latch at the same time.
static void step(int64_t t_ns)
{
    struct pc_device *d = &pc_device;
    d->now_ns = t_ns;
    pc_set_time(device_us(t_ns));
    if (rx_first_ns() == t_ns) {
        arrive(t_ns);
    } else if (d->booted_ns == t_ns) {
        d->booted_ns = NEVER;
        d->is_booting = false;
        forget(t_ns);
        d->supply_ns = after(t_ns, BILLION / 10);
        rig_begin();
    } else if (d->watchdog_ns == t_ns) {
        rig_watch_run();
    } else if (d->due_ns == t_ns) {
        step_converter(t_ns);
    } else if (d->timer_ns == t_ns) {
        tick();
    } else if (d->supply_ns == t_ns) {
        d->supply_ns = d->end_ns; // a busy converter measures as soon as it is free
        if (d->supply_ns == NEVER) {
            d->supply_ns = after(t_ns, BILLION / 10);
            rig_watch_supply();
        }
    } else {
        d->status_ns = after(t_ns, BILLION);
        rig_tell_status();
    }
    if (rig.motor.broken)
        rig_watch_run();
    settle(t_ns);
    plan_watchdog(t_ns);
    const int64_t dues[] = {d->due_ns, d->watchdog_ns, d->timer_ns, d->status_ns, d->booted_ns,
        d->supply_ns};
    d->next_ns = rx_first_ns();
    for (uint32_t i = 0; i < sizeof dues / sizeof *dues; i++)
        if (dues[i] < d->next_ns)
            d->next_ns = dues[i];
}

uint32_t pc_device_advance(int64_t now_ns, bool to_frame)
{
    struct pc_device *d = &pc_device;
    sent_bytes = 0;
    const uint32_t enough = to_frame ? 0 : SENT_BYTES - 1024;
    while (d->next_ns <= now_ns && sent_bytes <= enough && !d->has_failed)
        step(d->next_ns);
    return sent_bytes;
}
