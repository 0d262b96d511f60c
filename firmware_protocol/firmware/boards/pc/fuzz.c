// Passes random and mutated bytes to the core under the sanitizers, and checks the core's calls of
// its board. `fuzz BYTES SEED` prints what occurred and exits with 0, or aborts at the first
// violation.
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../../core/rig_frame.h" // rig_close
#include "../../core/rig_motor.h" // rig_code
#include "../../core/rig_state.h" // rig
#include "pc_board.h"

enum { BYTE_US = 20, NEVER = -1 };

static uint64_t random_state;
static uint32_t now_us;
static uint64_t taken_bytes;

static struct {
    bool is_on; // from board_motor_set to board_motor_off
    uint16_t duty;
    uint8_t asked, asked_begun; // requested samples that wait or are in progress
    int64_t tick_us, tick_ts_us, k, k_stop; // time to the timer's next sample, its period and its k
    uint32_t ticks_waiting;
    uint16_t cal_left;
    uint8_t cal_channel;
    bool is_busy, is_timed, is_latched;
    uint8_t conversions, done; // of the sample in progress
    int64_t next_us; // time to the end of the next conversion
} board;

static struct {
    uint64_t frames, samples, latches, events, runs, faults[12], states[8], cals;
} seen;

// Returns the next random number (xorshift64*).
static uint32_t draw(void)
{
    random_state ^= random_state >> 12;
    random_state ^= random_state << 25;
    random_state ^= random_state >> 27;
    return (uint32_t)(random_state * 0x2545F4914F6CDD1DULL >> 32);
}

// Returns true with a probability of `of_256`/256.
static bool happens(uint32_t of_256)
{
    return (draw() & 255) < of_256;
}

// Aborts the program if a requirement is violated.
static void require(bool holds, const char *what)
{
    if (holds)
        return;
    fprintf(stderr, "violated after %" PRIu64 " bytes, state %u: %s\n", taken_bytes, rig.state, what);
    abort();
}

// Turns the motor off.
static void motor_off(void)
{
    board.is_on = false;
    board.duty = 0;
}

// Checks that the motor is driven only in RUN, with duties that the configuration allows.
static void motor_set(uint16_t duty)
{
    require(rig.state == RIG_STATE_RUN, "the motor is driven in RUN alone");
    const uint16_t least = rig_duty(rig.config.u_min), most = rig_duty(rig.config.u_max);
    const bool is_rest = duty == rig_duty(rig.config.u_rest);
    require(is_rest || (least <= duty && duty <= most), "a duty within the limits");
    board.is_on = true;
    board.duty = duty;
    seen.latches++;
}

static void convert_now(void)
{
    board.asked++;
    require(board.asked <= RIG_MOST_ASKED, "two samples asked for at a time");
}

static void timer_start(uint32_t t0_us, uint32_t ts_us, uint32_t k_stop)
{
    require(t0_us - now_us == ts_us, "the first sample is one Ts away");
    board.tick_us = (int64_t)ts_us - (2 * rig_oversampling() - 1) * BOARD_SKEW_US;
    require(board.tick_us > 0, "the first conversion is to come");
    board.tick_ts_us = ts_us;
    board.k = 0;
    board.k_stop = k_stop ? (int64_t)k_stop : INT64_MAX;
    seen.runs++;
}

static void timer_stop(void) { board.tick_us = NEVER; }
static bool converter_is_free(void) { return !board.is_busy && !board.asked && !board.ticks_waiting; }

static void convert_channel(uint8_t channel, uint16_t n)
{
    require(converter_is_free() && !board.cal_left, "CAL has the converter alone");
    require(channel < 2 && n >= 1 && n <= 1024, "readings");
    board.cal_channel = channel;
    board.cal_left = n;
    board.next_us = BOARD_SKEW_US;
}

static void measure_supply(void)
{
    rig_supply(happens(8) ? 3900 : 5000);
}

// Checks that each frame to the host is valid. At random, the transmit buffer has no room.
static bool send(const uint8_t *bytes, uint8_t n)
{
    seen.frames++;
    require(bytes[n - 1] == 0 && n <= RIG_MAX_DECODED + 2, "a frame ends with 00");
    if (n == 1)
        return true;
    union rig_frame frame = {0};
    memcpy(frame.wire, bytes, n);
    require(memchr(bytes, 0, n) == bytes + n - 1, "no 00 within a frame");
    require(rig_open(&frame, n - 1) == RIG_SOUND, "a frame is sound");
    const union rig_message *m = &frame.message;
    require(m->header.state == rig.state, "a frame tells the state");
    if (m->header.type == RIG_TYPE_SAMPLE) {
        seen.samples++;
        require(m->sample.u_k == 0 || rig.state == RIG_STATE_RUN, "u_k is 0 outside RUN");
    }
    if (m->header.type == RIG_TYPE_EVENT) {
        seen.events++;
        seen.states[m->header.state]++;
        if (m->header.state == RIG_STATE_FAULT)
            seen.faults[m->event.cause]++;
    }
    seen.cals += m->header.type == RIG_TYPE_CAL_R;
    return !happens(8);
}

static uint32_t send_us(void) { return now_us; }
static uint32_t token(void) { return draw() | 1; }

// Returns a code that a potentiometer can have: anywhere in the range, or at a rail.
static uint16_t reading(void)
{
    static uint16_t last;
    last += (draw() & 0x3FF) - 0x180;
    return happens(8) ? (happens(128) ? 0 : 0xFFC0) : last & 0xFFC0;
}

// Begins the next waiting sample. Samples of the timer precede requested samples.
static void begin_sample(void)
{
    if (board.is_busy || board.cal_left || (!board.asked && !board.ticks_waiting))
        return;
    board.is_timed = board.ticks_waiting > 0;
    board.is_busy = true;
    board.is_latched = false;
    board.conversions = 2 * rig_oversampling();
    board.done = 0;
    board.next_us = BOARD_SKEW_US;
}

// Ends a conversion. The last conversion also ends the sample.
static void end_conversion(void)
{
    const uint8_t what = board.is_timed ? RIG_TIMED : RIG_ASKED;
    board.next_us = BOARD_SKEW_US;
    if (board.cal_left) {
        rig_reading(board.cal_channel, reading());
        board.cal_left--;
        return;
    }
    board.done++;
    if (board.done == board.conversions)
        rig_latch(what);
    rig_reading(board.done & 1, reading());
    if (board.done < board.conversions)
        return;
    rig_converted(what | (happens(30) ? RIG_LATE : 0), now_us - (BOARD_SKEW_US - BOARD_HOLD_US));
    board.is_busy = false;
    if (board.is_timed)
        board.ticks_waiting--;
    else
        board.asked--;
}

// Advances the time of the board by `us`.
static void pass(uint32_t us)
{
    now_us += us;
    pc_set_time(now_us);
    if (board.tick_us != NEVER && (board.tick_us -= us) <= 0) {
        if (board.k == board.k_stop) {
            timer_stop();
            rig_end();
            require(!board.is_on, "the end is 0 V");
        } else {
            board.k++;
            board.ticks_waiting++;
            board.tick_us += board.tick_ts_us;
        }
    }
    begin_sample();
    if ((board.is_busy || board.cal_left) && (board.next_us -= us) <= 0)
        end_conversion();
    if (!happens(10)) // sometimes main is late
        rig_poll();
    require(!board.is_on || rig.state == RIG_STATE_RUN, "0 V in every state but RUN");
}

// Passes bytes to the core, usually each after the time of a byte.
static void give(const uint8_t *bytes, uint32_t n)
{
    for (; n; n--, taken_bytes++) {
        rig_receive(*bytes++);
        require(!board.is_on || rig.state == RIG_STATE_RUN, "0 V in every state but RUN");
        if (!happens(64)) // without this delay, the line is faster than a real line
            pass(BYTE_US);
    }
}

static uint16_t host_seq;
static uint32_t host_k;

// Returns a code that the configuration usually allows.
static uint16_t some_code(void)
{
    if (happens(8))
        return draw();
    const uint32_t span = rig.config.u_max - rig.config.u_min + 1U;
    return rig.config.u_min + draw() % span;
}

// Fills a CONFIG that the core usually accepts.
static void fill_config(rig_config_t *m)
{
    m->ts_us = happens(16) ? draw() & 0x3FFF : 500 + (draw() & 0x7FF);
    m->u_min = happens(64) ? draw() & 0xFFF : 0;
    m->u_max = happens(64) ? draw() | 0x1000 : 65535;
    m->u_rest = happens(32) ? draw() : m->u_min;
    m->slew = happens(64) ? draw() : 0;
    m->watchdog_ms = 20 + draw() % 231 + happens(2);
    m->mode = happens(8) ? draw() & 3 : draw() & 1;
    m->underrun = happens(8) ? draw() & 3 : draw() & 1;
    m->hold = draw() & 7;
    m->oversampling = happens(32) ? draw() & 7 : 1;
    m->rail_ticks = happens(64) ? 1 + (draw() & 3) : 0;
    m->turns = happens(64) ? 1 + (draw() & 31) : 0;
}

// Fills SETPOINTS that usually begin directly after the queue's last entry.
static void fill_setpoints(rig_setpoints_t *m)
{
    m->k0 = rig.queue.next + rig.queue.count + (happens(64) ? draw() % 60 - 30 : 0);
    m->n = happens(8) ? draw() : 1 + draw() % RIG_SETPOINTS_PER_FRAME;
    m->zero = happens(4);
    for (uint8_t i = 0; i < RIG_SETPOINTS_PER_FRAME; i++)
        m->u[i] = some_code();
}

// Fills a message of a type with the boot_id, nonce and token that a correct host would send.
static void fill(union rig_message *m, uint8_t type)
{
    switch (type) {
    case RIG_TYPE_CONFIG: fill_config(&m->config); break;
    case RIG_TYPE_ARM:
        m->arm.boot_id = rig.boot_id;
        m->arm.config_crc = rig.config_crc;
        m->arm.nonce = rig.nonce;
        break;
    case RIG_TYPE_START:
        m->start.k_stop = rig.config.mode ? draw() & 15 : 0;
        m->start.nonce = rig.nonce;
        break;
    case RIG_TYPE_CLEAR_FAULT: m->clear_fault.token = rig.token; break;
    case RIG_TYPE_EXCHANGE:
        m->exchange.k = ++host_k;
        m->exchange.u = some_code();
        break;
    case RIG_TYPE_SETPOINTS: fill_setpoints(&m->setpoints); break;
    case RIG_TYPE_CAL:
        m->cal.channel = draw() & 1;
        m->cal.n = 1 + (draw() & 31);
        break;
    default: break;
    }
}

// Returns the type of the host's next frame: usually a type that leads to RUN, or continues RUN.
static uint8_t some_type(void)
{
    static const uint8_t types[] = {
        RIG_TYPE_HELLO, RIG_TYPE_STOP, RIG_TYPE_ESTOP, RIG_TYPE_PING, RIG_TYPE_KEEPALIVE,
        RIG_TYPE_CAL, RIG_TYPE_CONFIG, RIG_TYPE_ARM, RIG_TYPE_START, RIG_TYPE_CLEAR_FAULT,
    };
    if (happens(16))
        return types[draw() % sizeof types];
    switch (rig.state) {
    case RIG_STATE_IDLE: return RIG_TYPE_CONFIG;
    case RIG_STATE_READY: return RIG_TYPE_ARM;
    case RIG_STATE_ARMED: return happens(128) ? RIG_TYPE_START : RIG_TYPE_SETPOINTS;
    case RIG_STATE_RUN: return rig.config.mode ? RIG_TYPE_SETPOINTS : RIG_TYPE_EXCHANGE;
    default: return RIG_TYPE_CLEAR_FAULT;
    }
}

// Builds a frame of the host, and returns its length on the wire. Sometimes the body, the type or
// the length is random.
static uint8_t make_frame(union rig_frame *frame)
{
    union rig_message *m = &frame->message;
    memset(frame, 0, sizeof *frame);
    const uint8_t type = some_type();
    uint8_t length = rig_length(type);
    fill(m, type);
    if (happens(8))
        for (uint8_t i = sizeof m->header; i < length; i++)
            m->bytes[i] = draw();
    m->header.type = happens(4) ? draw() : type;
    m->header.seq = host_seq += happens(4) ? draw() : 1;
    if (happens(2))
        length = 8 + draw() % (RIG_MAX_DECODED - 7);
    return rig_close(frame, length);
}

// Flips at most three bits, and sometimes cuts the frame. Returns the new length.
static uint8_t spoil(uint8_t *bytes, uint8_t n)
{
    for (uint32_t flips = draw() & 3; flips; flips--)
        bytes[draw() % n] ^= 1 << (draw() & 7);
    return happens(64) ? 1 + draw() % n : n;
}

int main(int argc, char **argv)
{
    if (argc != 3) {
        fprintf(stderr, "usage: fuzz BYTES SEED\n");
        return 2;
    }
    const uint64_t bytes = strtoull(argv[1], NULL, 10);
    random_state = strtoull(argv[2], NULL, 10) * 2 + 1;
    const struct pc_hardware hardware = {motor_off, motor_set, convert_now, timer_start, timer_stop,
        converter_is_free, convert_channel, measure_supply, send, send_us, token};
    pc_plug(&hardware);
    board.tick_us = NEVER;
    pc_reset(draw(), 1);
    rig_begin();
    while (taken_bytes < bytes) {
        if (happens(20)) {
            uint8_t noise[150];
            const uint32_t n = draw() % sizeof noise;
            for (uint32_t i = 0; i < n; i++)
                noise[i] = draw();
            give(noise, n);
        }
        union rig_frame frame;
        uint8_t n = make_frame(&frame);
        if (happens(16))
            n = spoil(frame.wire, n);
        give(frame.wire, n);
        if (happens(4))
            for (uint32_t us = draw() % 300000; us > BYTE_US; us -= BYTE_US)
                pass(BYTE_US);
        if (happens(1))
            pc_lose(draw());
    }
    printf("bytes %" PRIu64 ", sound %" PRIu32 ", spoilt %" PRIu32 ", sent %" PRIu64, taken_bytes,
        rig.counters.frames, rig.counters.spoilt, seen.frames);
    printf(", samples %" PRIu64 ", latches %" PRIu64 ", timed runs %" PRIu64 ", cals %" PRIu64,
        seen.samples, seen.latches, seen.runs, seen.cals);
    for (int i = RIG_STATE_IDLE; i <= RIG_STATE_ESTOP; i++)
        printf(", state %d %" PRIu64, i, seen.states[i]);
    for (int i = RIG_CAUSE_WATCHDOG; i <= RIG_CAUSE_VCC_LOW; i++)
        if (i != RIG_CAUSE_UNDERRUN)
            printf(", fault %d %" PRIu64, i, seen.faults[i]);
    printf("\n");
    return 0;
}
