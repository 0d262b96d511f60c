// Triggers an interrupt between any two memory accesses of the core while interrupts are on. The
// outcome must equal the outcome of the interrupt before all of main's work, or after all of it.
//
// The core is compiled for the thread sanitizer, which calls a function before each memory access.
// This program supplies that function, and triggers the interrupt in it. `interrupts` prints the
// number of interrupts and exits with 0. At the first unexpected outcome it exits with 1.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../../core/rig_frame.h" // rig_open
#include "../../core/rig_sampling.h" // rig_ask, rig_tell_samples
#include "../../core/rig_state.h" // rig
#include "../../core/rig_states.h" // rig_enter
#include "pc_board.h"

enum { NEVER = -1, K = 100, LOOKED_BYTES = 1 << 12 };

static long tried_place, places_left = NEVER; // place of the interrupt; places until it
static bool is_off, is_interrupt; // interrupts are off; the interrupt is in progress
static bool is_timed, is_driven; // the timer runs; the motor is driven
static unsigned long interrupts, outcomes;
static uint8_t looked[LOOKED_BYTES]; // all observable values of an outcome
static uint32_t looked_bytes;

// A case: the work of main, the interrupt, and the functions that prepare and observe the state.
struct meeting {
    const char *name;
    void (*prepare)(void);
    void (*main)(void);
    void (*interrupt)(void);
    void (*look)(void);
    bool is_stopped; // the interrupt occurs only while the timer runs
};
static const struct meeting *meeting;

static rig_setpoints_t frame;
static uint16_t held, first; // setpoints in the queue; place of the first setpoint

// Ends the program at a forbidden outcome.
static void fail(const char *why)
{
    fprintf(stderr, "%s, interrupted at place %ld: %s; queue of %u at %u, frame of %u at %+d\n",
        meeting->name, tried_place, why, held, first, frame.n, (int)(frame.k0 - K));
    exit(1);
}

// ------------------------------------------------------------- the interrupt

static void interrupt(void)
{
    is_interrupt = true;
    meeting->interrupt();
    is_interrupt = false;
    interrupts++;
}

// Triggers the interrupt if its place is reached and interrupts are on.
static void place(void)
{
    if (places_left == NEVER || is_off || is_interrupt || places_left-- > 0)
        return;
    places_left = NEVER;
    if (is_timed || !meeting->is_stopped)
        interrupt();
}

uint8_t board_irq_save(void)
{
    place();
    const uint8_t before = is_off;
    is_off = true;
    return before;
}

void board_irq_restore(uint8_t before)
{
    is_off = before;
    place();
}

#define ACCESS(name) void __tsan_##name(void *at); void __tsan_##name(void *at) { (void)at; place(); }
#define RANGE(name) \
    void __tsan_##name(void *at, size_t n); \
    void __tsan_##name(void *at, size_t n) { (void)at; (void)n; place(); }
ACCESS(read1) ACCESS(read2) ACCESS(read4) ACCESS(read8) ACCESS(read16)
ACCESS(write1) ACCESS(write2) ACCESS(write4) ACCESS(write8) ACCESS(write16)
ACCESS(unaligned_read2) ACCESS(unaligned_read4) ACCESS(unaligned_read8)
ACCESS(unaligned_write2) ACCESS(unaligned_write4) ACCESS(unaligned_write8)
RANGE(read_range) RANGE(write_range)
void __tsan_func_entry(void *at);
void __tsan_func_entry(void *at) { (void)at; }
void __tsan_func_exit(void);
void __tsan_func_exit(void) {}
void __tsan_init(void);
void __tsan_init(void) {}

// ------------------------------------------------------------- the board

static void motor_off(void) { is_driven = false; }
static void motor_set(uint16_t duty) { is_driven = duty != 0; }
static void convert_now(void) {}
static void timer_start(uint32_t t0_us, uint32_t ts_us, uint32_t k_stop)
{
    (void)t0_us, (void)ts_us, (void)k_stop;
}
static void timer_stop(void) { is_timed = false; }
static bool converter_is_free(void) { return true; }
static void convert_channel(uint8_t channel, uint16_t n) { (void)channel, (void)n; }
static void measure_supply(void) {}
static uint32_t send_us(void) { return 0; }
static uint32_t token(void) { return 1; }

// Appends bytes to the observed values.
static void see(const void *bytes, size_t n)
{
    if (looked_bytes + n > sizeof looked)
        abort();
    memcpy(looked + looked_bytes, bytes, n);
    looked_bytes += n;
}

static void see_number(uint32_t number)
{
    see(&number, sizeof number);
}

// Appends the index, the readings and the input of a SAMPLE to the observed values.
static bool send(const uint8_t *bytes, uint8_t n)
{
    union rig_frame frame = {0};
    memcpy(frame.wire, bytes, n);
    if (n > 1 && rig_open(&frame, n - 1) == RIG_SOUND && frame.message.header.type == RIG_TYPE_SAMPLE) {
        const rig_sample_t *m = &frame.message.sample;
        see_number(m->k);
        see_number(m->y0 << 16 | m->y1);
        see_number(m->u_k << 16 | m->u_seq);
    }
    return true;
}

// ------------------------------------------------------------- SETPOINTS, and a sample falls due

static enum rig_put put;
static uint16_t refused;

static void prepare_queue(void)
{
    rig.config = (rig_config_t){.u_max = 50000, .slew = frame.zero ? 300 : 0, .mode = RIG_MODE_SCHEDULED,
        .underrun = RIG_UNDERRUN_HOLD, .hold = UINT8_MAX};
    rig_queue_begin(&rig.queue, 0);
    // The setpoint of sample k is 100 k. The setpoints came in frames of 8.
    rig.queue.next = K;
    rig.queue.first = first;
    rig.queue.first_frame = first % RIG_QUEUE_FRAMES;
    rig.queue.in_force = (struct rig_setpoint){.u = 100 * (K - 1), .seq = 9};
    for (uint16_t at = 0; at < held; at += 8) {
        rig_setpoints_t m = {.seq = 10 + at, .k0 = K + at, .n = held - at < 8 ? held - at : 8};
        for (uint8_t i = 0; i < m.n; i++)
            m.u[i] = 100 * (K + at + i);
        rig_queue_put(&rig.queue, &rig.config, &m, &refused);
    }
    refused = 0;
}

static void put_frame(void)
{
    put = rig_queue_put(&rig.queue, &rig.config, &frame, &refused);
}

static void take_one(void)
{
    rig_queue_take(&rig.queue, &rig.config);
}

static void look_at_queue(void)
{
    see_number(put);
    see_number(put == RIG_PUT_OUT_OF_RANGE || put == RIG_PUT_TOO_STEEP ? refused : 0);
    see_number(rig.queue.next);
    see_number(rig_queue_count(&rig.queue));
    do {
        see_number(rig.queue.in_force.u << 16 | rig.queue.in_force.seq);
    } while (rig_queue_take(&rig.queue, &rig.config));
    see_number(rig.queue.frames);
}

// ------------------------------------------------------------- samples are sent, and one ends

static uint8_t waiting;

// Ends a sample, either of the timer or of an EXCHANGE.
static void end_sample(uint8_t what)
{
    const uint32_t k = what & RIG_TIMED ? rig.timed_k : rig.asked[rig.asked_first].k;
    const uint16_t y = 1000 + k;
    rig_reading(1, y);
    rig_reading(0, y + 7);
    rig_latch(what);
    rig_converted(what, y);
}

static void end_timed(void) { end_sample(RIG_TIMED); }
static void end_asked(void) { end_sample(RIG_ASKED); }

static void run(uint8_t mode)
{
    rig.config = (rig_config_t){.u_max = 50000, .mode = mode, .watchdog_ms = 250};
    rig.state = RIG_STATE_RUN;
    rig.motor.live = true;
    is_driven = true;
}

static void prepare_samples(void)
{
    run(RIG_MODE_SCHEDULED);
    rig_queue_begin(&rig.queue, 0);
    rig_setpoints_t m = {.seq = 7, .n = 6, .u = {20000, 21000, 22000, 23000, 24000, 25000}};
    rig_queue_put(&rig.queue, &rig.config, &m, &refused);
    for (uint8_t i = 0; i < waiting; i++)
        end_timed();
}

static void look_at_samples(void)
{
    rig_tell_samples();
    see_number(rig.taken_count);
    see_number(rig.counters.tx_dropped);
}

// ------------------------------------------------------------- EXCHANGE, and a sample ends

static void prepare_asked(void)
{
    run(RIG_MODE_EXCHANGE);
    rig_ask(&(rig_exchange_t){.seq = 3, .k = 5, .u = 20000}, true);
}

static void ask_another(void)
{
    rig_ask(&(rig_exchange_t){.seq = 4, .k = 6, .u = 30000}, true);
}

static void look_at_asked(void)
{
    rig_tell_samples();
    while (rig.asked_count) {
        end_asked();
        rig_tell_samples();
    }
    see_number(rig.asked_first);
}

// ------------------------------------------------------------- a trip, and a latch or the end

static void latch_timed(void) { rig_latch(RIG_TIMED); }
static void latch_asked(void) { rig_latch(RIG_ASKED); }
static void trip(void) { rig_enter(RIG_STATE_FAULT, RIG_CAUSE_WATCHDOG, 0); }

// Checks that a late latch leaves the motor off, and that FAULT remains until CLEAR_FAULT.
static void look_at_motor(void)
{
    if (is_driven)
        fail("the motor is driven");
    latch_timed();
    if (rig.asked_count)
        latch_asked();
    if (is_driven || rig.motor.duty)
        fail("the motor is driven again");
    rig_tell_samples();
    if (rig.state != RIG_STATE_FAULT || rig.cause != RIG_CAUSE_WATCHDOG || rig_queue_count(&rig.queue))
        fail("the trip does not hold");
}

// ------------------------------------------------------------- every place

// Runs the case with the interrupt before main's work, after it, or at a place in it. Returns true
// if the interrupt occurred at the place.
static bool meet(bool before, bool after, long at)
{
    memset(&rig, 0, sizeof rig);
    is_off = is_driven = false;
    is_timed = true;
    looked_bytes = 0;
    meeting->prepare();
    looked_bytes = 0;
    if (before)
        interrupt();
    places_left = tried_place = at;
    meeting->main();
    if (is_off)
        fail("interrupts are left off");
    const bool came = places_left == NEVER;
    places_left = NEVER;
    if (after && (is_timed || !meeting->is_stopped))
        interrupt();
    meeting->look();
    outcomes++;
    return came;
}

static void try_every_place(const struct meeting *tried)
{
    static uint8_t expected[2][LOOKED_BYTES];
    uint32_t bytes[2];
    meeting = tried;
    for (int i = 0; i < 2; i++) {
        meet(i == 0, i == 1, NEVER);
        bytes[i] = looked_bytes;
        memcpy(expected[i], looked, looked_bytes);
    }
    for (long at = 0; meet(false, false, at); at++) {
        bool is_either = false;
        for (int i = 0; i < 2; i++)
            is_either |= looked_bytes == bytes[i] && memcmp(looked, expected[i], bytes[i]) == 0;
        if (!is_either)
            fail("another outcome");
    }
}

// Tries frames of n codes that begin at each index from before the queue's first setpoint to after
// its last.
static void try_frames(uint8_t n, bool has_slew, bool agrees)
{
    static const struct meeting setpoints = {
        "SETPOINTS", prepare_queue, put_frame, take_one, look_at_queue, false};
    for (int offset = -n - 1; offset <= held + 1; offset++) {
        frame = (rig_setpoints_t){.seq = 99, .k0 = K + offset, .n = n, .zero = has_slew};
        for (uint8_t i = 0; i < n; i++)
            frame.u[i] = 100 * (K + offset + i) + !agrees;
        try_every_place(&setpoints);
    }
}

// Tries queues of several lengths, at two places in their ring.
static void try_queues(void)
{
    static const uint16_t lengths[] = {0, 1, 2, 9, BOARD_QUEUE - 1, BOARD_QUEUE};
    for (unsigned i = 0; i < sizeof lengths / sizeof *lengths; i++) {
        held = lengths[i];
        for (first = 3; first < BOARD_QUEUE; first += BOARD_QUEUE - 4) {
            for (uint8_t kind = 0; kind < 4; kind++) {
                try_frames(3, kind & 1, kind & 2);
                try_frames(RIG_SETPOINTS_PER_FRAME, kind & 1, kind & 2);
            }
        }
    }
}

int main(void)
{
    static const struct meeting samples = {
        "samples", prepare_samples, rig_tell_samples, end_timed, look_at_samples, false};
    static const struct meeting others[] = {
        {"EXCHANGE", prepare_asked, ask_another, end_asked, look_at_asked, false},
        {"a trip in exchange mode", prepare_asked, trip, latch_asked, look_at_motor, false},
        {"a trip in scheduled mode", prepare_samples, trip, latch_timed, look_at_motor, false},
        {"a trip at the end", prepare_samples, trip, rig_end, look_at_motor, true},
    };
    const struct pc_hardware hardware = {motor_off, motor_set, convert_now, timer_start, timer_stop,
        converter_is_free, convert_channel, measure_supply, send, send_us, token};
    pc_plug(&hardware);
    try_queues();
    for (waiting = 0; waiting <= RIG_MOST_TAKEN; waiting++)
        try_every_place(&samples);
    waiting = 1;
    for (unsigned i = 0; i < sizeof others / sizeof *others; i++)
        try_every_place(&others[i]);
    printf("interrupts %lu, outcomes %lu\n", interrupts, outcomes);
    return 0;
}
