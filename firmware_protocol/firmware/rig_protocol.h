// Messages of the wire; generated from schema.toml, not to be edited.
// A structure has the bytes of its frame before stuffing: packed, little-endian.
#ifndef RIG_PROTOCOL_H
#define RIG_PROTOCOL_H

#include <stdint.h>

#define RIG_VERSION 2
#define RIG_SCHEMA_HASH 0xF7128A84UL
#define RIG_MAX_DECODED 64U // Longest decoded frame, header and CRC included, in bytes.
#define RIG_QUEUE_CAPACITY 512U // Largest capacity of a device's queue of setpoints; `queue` in HELLO_R is the capacity of the device.
#define RIG_SETPOINTS_PER_FRAME 24U // Largest number of codes in one SETPOINTS frame.
#define RIG_CODE_FULL_SCALE 65535U // Code of the full-scale voltage. Code 0 is 0 V, and the codes are linear in the voltage.
#define RIG_FULL_SCALE_MV 5000U // Full-scale motor voltage, in mV. A higher voltage destroys the rig.
#define RIG_WATCHDOG_MIN_MS 20U // Shortest watchdog time that a device accepts, in ms.
#define RIG_WATCHDOG_MAX_MS 250U // Longest watchdog time that a device accepts, in ms. The watchdog cannot be switched off.
#define RIG_WATCHDOG_DEFAULT_MS 100U // Watchdog time that a host requests by default, in ms.
#define RIG_MAX_UNECHOED 2U // Largest number of EXCHANGE frames that a host has sent and that are not yet echoed.

// State of the device, in byte 1 of each of its frames.
enum {
    RIG_STATE_HOST = 0x0, // the sender is the host
    RIG_STATE_BOOT = 0x1, // starting up; 0 V
    RIG_STATE_IDLE = 0x2, // no configuration accepted; 0 V
    RIG_STATE_READY = 0x3, // configured; 0 V
    RIG_STATE_ARMED = 0x4, // bound to a host; 0 V, watchdog on
    RIG_STATE_RUN = 0x5, // the input drives the motor, watchdog on
    RIG_STATE_FAULT = 0x6, // latched; 0 V; only CLEAR_FAULT with the token of this fault ends it
    RIG_STATE_ESTOP = 0x7, // latched on request; 0 V; only CLEAR_FAULT with the token of this stop ends it
};

// Reason for a change of the device's state.
enum {
    RIG_CAUSE_NONE = 0x0, // no cause to report
    RIG_CAUSE_POWER_ON = 0x1, // reset, for example at power-on or when the port is opened
    RIG_CAUSE_REQUEST = 0x2, // requested by a host
    RIG_CAUSE_END = 0x3, // the last requested sample was taken, and its input was held for a whole Ts
    RIG_CAUSE_WATCHDOG = 0x4, // no valid host frame for watchdog_ms
    RIG_CAUSE_RANGE = 0x5, // a code outside [u_min, u_max]
    RIG_CAUSE_SLEW = 0x6, // a change of the code of more than `slew`
    RIG_CAUSE_ADC_RAIL = 0x7, // a potentiometer at a rail for `rail_ticks` samples
    RIG_CAUSE_REV_LIMIT = 0x8, // `turns`/100 net turns of channel 0 or more since START
    RIG_CAUSE_UNDERRUN = 0x9, // reserved: an empty queue of setpoints is no fault
    RIG_CAUSE_VCC_LOW = 0xA, // supply too low
    RIG_CAUSE_INTERNAL = 0xB, // an internal check of the firmware failed
};

// Answer to a request.
enum {
    RIG_CODE_OK = 0x0, // done
    RIG_CODE_UNKNOWN_TYPE = 0x1, // no request has this type
    RIG_CODE_WRONG_STATE = 0x2, // the request is not allowed in this state; nothing changed
    RIG_CODE_UNSUPPORTED = 0x3, // the device does not have this function; see `capabilities`
    RIG_CODE_BAD_VALUE = 0x4, // a field has a value that is not allowed; nothing changed
    RIG_CODE_WRONG_BOOT = 0x5, // wrong boot_id: not the boot_id of this boot
    RIG_CODE_WRONG_CONFIG = 0x6, // wrong config_crc: not the config_crc of the configuration in force
    RIG_CODE_WRONG_TOKEN = 0x7, // wrong token: not the token of this fault
    RIG_CODE_STALE = 0x8, // seq or k is not newer than the last accepted seq or k; nothing changed
    RIG_CODE_WRONG_NONCE = 0x9, // wrong nonce: not the nonce of the newest accepted CONFIG; for example, an old frame was sent again
};

// Clock that determines the times of the samples.
enum {
    RIG_MODE_EXCHANGE = 0x0, // the host's clock; the device sends one SAMPLE for each EXCHANGE
    RIG_MODE_SCHEDULED = 0x1, // the device's timer; the inputs are in a queue of setpoints
};

// Code that a device latches if its queue is empty.
enum {
    RIG_UNDERRUN_ZERO = 0x0, // u_rest at once
    RIG_UNDERRUN_HOLD = 0x1, // the last code for `hold` ticks, then u_rest
};

// Conditions that a device reports with a sample.
enum {
    RIG_FLAG_RUN = 0x1, // u_k drives the motor
    RIG_FLAG_ARMED = 0x2, // ARMED or RUN
    RIG_FLAG_UNDERRUN = 0x4, // no setpoint for this k
    RIG_FLAG_WATCHDOG = 0x8, // in FAULT, caused by the watchdog
    RIG_FLAG_RANGE = 0x10, // in FAULT, caused by a code out of range
    RIG_FLAG_SLEW = 0x20, // in FAULT, caused by a change of the input that is too large
    RIG_FLAG_ADC0_RAIL = 0x40, // channel 0 at a rail: dead band or broken wire
    RIG_FLAG_ADC1_RAIL = 0x80, // channel 1 at a rail
    RIG_FLAG_TICK_LATE = 0x100, // this sample was taken late
    RIG_FLAG_ESTOP = 0x200, // in ESTOP
    RIG_FLAG_CRC_ERR = 0x400, // a spoilt frame was received since the last sample
    RIG_FLAG_RX_OVERFLOW = 0x800, // received bytes were lost since the last sample
    RIG_FLAG_TX_DROP = 0x1000, // frames to the host were dropped since the last sample
    RIG_FLAG_REV_LIMIT = 0x2000, // in FAULT, caused by too many turns
    RIG_FLAG_VCC_LOW = 0x4000, // supply below 4000 mV when last measured
};

// Functions of a device.
enum {
    RIG_CAPABILITY_EXCHANGE = 0x1, // exchange mode
    RIG_CAPABILITY_SCHEDULED = 0x2, // scheduled mode
    RIG_CAPABILITY_CAL = 0x4, // CAL
    RIG_CAPABILITY_ENABLE_LINE = 0x8, // enable line of the motor driver, driven by the device
};

// Ask for the identity of the device. Outside ARMED and RUN, also begin a new sequence.
#define RIG_TYPE_HELLO 0x01U
typedef struct __attribute__((packed)) {
    uint8_t type;
    uint8_t state; // state of the device; 0 from a host (`State`)
    uint16_t seq; // number of the frame, counted by its sender
    uint16_t version; // protocol version of the host
    uint32_t schema; // schema hash of the host
    uint32_t crc; // CRC-32/ISO-HDLC of all bytes before it
} rig_hello_t;
_Static_assert(sizeof(rig_hello_t) == 14, "HELLO");
_Static_assert(sizeof(rig_hello_t) <= RIG_MAX_DECODED, "HELLO");

// Set the run's parameters, in IDLE or READY.
#define RIG_TYPE_CONFIG 0x02U
typedef struct __attribute__((packed)) {
    uint8_t type;
    uint8_t state; // state of the device; 0 from a host (`State`)
    uint16_t seq; // number of the frame, counted by its sender
    uint32_t ts_us; // sampling time, in µs
    uint16_t u_min; // lowest code accepted, in code
    uint16_t u_max; // highest code accepted, in code
    uint16_t u_rest; // code at which the motor stands still, latched when RUN begins and after an underrun, in code; 0 if there is no enable line
    uint16_t slew; // largest change from one sample to the next, in code; 0 sets no limit
    uint16_t watchdog_ms; // time without a host frame after which the device enters FAULT(WATCHDOG), in ms
    uint8_t mode; // clock that determines the times of the samples (`Mode`)
    uint8_t underrun; // policy for an empty queue (`Underrun`)
    uint8_t hold; // longest time for which the policy HOLD keeps the last code, in ticks
    uint8_t oversampling; // conversions averaged in one reading of each channel, at least 1
    uint16_t rail_ticks; // samples in a row at a rail that cause FAULT(ADC_RAIL) in RUN, in samples; 0 sets no limit
    uint16_t turns; // net turns of channel 0 since START that cause FAULT(REV_LIMIT), in turns/100; 0 sets no limit
    uint32_t crc; // CRC-32/ISO-HDLC of all bytes before it
} rig_config_t;
_Static_assert(sizeof(rig_config_t) == 30, "CONFIG");
_Static_assert(sizeof(rig_config_t) <= RIG_MAX_DECODED, "CONFIG");

// Change from READY to ARMED. ARM is valid only in this boot and for this configuration and its nonce.
#define RIG_TYPE_ARM 0x03U
typedef struct __attribute__((packed)) {
    uint8_t type;
    uint8_t state; // state of the device; 0 from a host (`State`)
    uint16_t seq; // number of the frame, counted by its sender
    uint32_t boot_id; // as in HELLO_R
    uint32_t config_crc; // as in CONFIG_R
    uint32_t nonce; // as in CONFIG_R
    uint32_t crc; // CRC-32/ISO-HDLC of all bytes before it
} rig_arm_t;
_Static_assert(sizeof(rig_arm_t) == 20, "ARM");
_Static_assert(sizeof(rig_arm_t) <= RIG_MAX_DECODED, "ARM");

// Change from ARMED to RUN.
#define RIG_TYPE_START 0x04U
typedef struct __attribute__((packed)) {
    uint8_t type;
    uint8_t state; // state of the device; 0 from a host (`State`)
    uint16_t seq; // number of the frame, counted by its sender
    uint32_t k_stop; // scheduled mode: number of samples, or 0 for samples until STOP; exchange mode: 0
    uint32_t nonce; // as in ARM
    uint32_t crc; // CRC-32/ISO-HDLC of all bytes before it
} rig_start_t;
_Static_assert(sizeof(rig_start_t) == 16, "START");
_Static_assert(sizeof(rig_start_t) <= RIG_MAX_DECODED, "START");

// Change from READY, ARMED or RUN to IDLE. STOP takes effect even if its seq is not newer than the last seq.
#define RIG_TYPE_STOP 0x05U
typedef struct __attribute__((packed)) {
    uint8_t type;
    uint8_t state; // state of the device; 0 from a host (`State`)
    uint16_t seq; // number of the frame, counted by its sender
    uint32_t crc; // CRC-32/ISO-HDLC of all bytes before it
} rig_stop_t;
_Static_assert(sizeof(rig_stop_t) == 8, "STOP");
_Static_assert(sizeof(rig_stop_t) <= RIG_MAX_DECODED, "STOP");

// Change from FAULT or ESTOP to IDLE. No program sends CLEAR_FAULT without an order of the user.
#define RIG_TYPE_CLEAR_FAULT 0x06U
typedef struct __attribute__((packed)) {
    uint8_t type;
    uint8_t state; // state of the device; 0 from a host (`State`)
    uint16_t seq; // number of the frame, counted by its sender
    uint32_t token; // as in the EVENT or HELLO_R that reported the fault
    uint32_t crc; // CRC-32/ISO-HDLC of all bytes before it
} rig_clear_fault_t;
_Static_assert(sizeof(rig_clear_fault_t) == 12, "CLEAR_FAULT");
_Static_assert(sizeof(rig_clear_fault_t) <= RIG_MAX_DECODED, "CLEAR_FAULT");

// Change from any state to ESTOP. ESTOP takes effect even if its seq is not newer than the last seq. A host sends ESTOP three times.
#define RIG_TYPE_ESTOP 0x07U
typedef struct __attribute__((packed)) {
    uint8_t type;
    uint8_t state; // state of the device; 0 from a host (`State`)
    uint16_t seq; // number of the frame, counted by its sender
    uint32_t crc; // CRC-32/ISO-HDLC of all bytes before it
} rig_estop_t;
_Static_assert(sizeof(rig_estop_t) == 8, "ESTOP");
_Static_assert(sizeof(rig_estop_t) <= RIG_MAX_DECODED, "ESTOP");

// Take a sample. In RUN of exchange mode, also latch u.
#define RIG_TYPE_EXCHANGE 0x10U
typedef struct __attribute__((packed)) {
    uint8_t type;
    uint8_t state; // state of the device; 0 from a host (`State`)
    uint16_t seq; // number of the frame, counted by its sender
    uint32_t k; // the host's tick index
    uint16_t u; // input from this sample on, in code
    uint32_t crc; // CRC-32/ISO-HDLC of all bytes before it
} rig_exchange_t;
_Static_assert(sizeof(rig_exchange_t) == 14, "EXCHANGE");
_Static_assert(sizeof(rig_exchange_t) <= RIG_MAX_DECODED, "EXCHANGE");

// Scheduled mode: the inputs of samples k0 … k0 + n - 1. If the queue already has a code for a sample, the frame must repeat this code.
#define RIG_TYPE_SETPOINTS 0x11U
typedef struct __attribute__((packed)) {
    uint8_t type;
    uint8_t state; // state of the device; 0 from a host (`State`)
    uint16_t seq; // number of the frame, counted by its sender
    uint32_t k0; // sample index of the first code
    uint8_t n; // number of codes, 1 to 24
    uint8_t zero; // 0
    uint16_t u[24]; // codes, in code; padded with 0
    uint32_t crc; // CRC-32/ISO-HDLC of all bytes before it
} rig_setpoints_t;
_Static_assert(sizeof(rig_setpoints_t) == 62, "SETPOINTS");
_Static_assert(sizeof(rig_setpoints_t) <= RIG_MAX_DECODED, "SETPOINTS");

// Ask for the device's clock.
#define RIG_TYPE_PING 0x12U
typedef struct __attribute__((packed)) {
    uint8_t type;
    uint8_t state; // state of the device; 0 from a host (`State`)
    uint16_t seq; // number of the frame, counted by its sender
    uint64_t host_ns; // host's clock when the host sent PING, in ns; returned in PONG
    uint32_t crc; // CRC-32/ISO-HDLC of all bytes before it
} rig_ping_t;
_Static_assert(sizeof(rig_ping_t) == 16, "PING");
_Static_assert(sizeof(rig_ping_t) <= RIG_MAX_DECODED, "PING");

// Feed the watchdog. KEEPALIVE has no other effect.
#define RIG_TYPE_KEEPALIVE 0x13U
typedef struct __attribute__((packed)) {
    uint8_t type;
    uint8_t state; // state of the device; 0 from a host (`State`)
    uint16_t seq; // number of the frame, counted by its sender
    uint32_t crc; // CRC-32/ISO-HDLC of all bytes before it
} rig_keepalive_t;
_Static_assert(sizeof(rig_keepalive_t) == 8, "KEEPALIVE");
_Static_assert(sizeof(rig_keepalive_t) <= RIG_MAX_DECODED, "KEEPALIVE");

// Ask for raw readings of one channel, at 0 V only.
#define RIG_TYPE_CAL 0x14U
typedef struct __attribute__((packed)) {
    uint8_t type;
    uint8_t state; // state of the device; 0 from a host (`State`)
    uint16_t seq; // number of the frame, counted by its sender
    uint8_t channel; // number of the channel, 0 or 1
    uint8_t zero; // 0
    uint16_t n; // readings, 1 to 1024
    uint32_t crc; // CRC-32/ISO-HDLC of all bytes before it
} rig_cal_t;
_Static_assert(sizeof(rig_cal_t) == 12, "CAL");
_Static_assert(sizeof(rig_cal_t) <= RIG_MAX_DECODED, "CAL");

// Identity and properties of the device.
#define RIG_TYPE_HELLO_R 0x81U
typedef struct __attribute__((packed)) {
    uint8_t type;
    uint8_t state; // state of the device; 0 from a host (`State`)
    uint16_t seq; // number of the frame, counted by its sender
    uint16_t version; // protocol version of the device
    uint32_t schema; // schema hash of the device
    uint64_t uid; // identifies this piece of hardware
    uint32_t boot_id; // drawn at each boot, never 0
    uint32_t firmware; // CRC-32 of the firmware's image
    uint32_t token; // token that CLEAR_FAULT must contain; 0 outside FAULT and ESTOP
    uint32_t ts_min_us; // shortest sampling time of the device itself, with oversampling 1, in µs
    uint16_t full_scale_mv; // voltage of code 65535, in mV
    uint16_t queue; // capacity of the queue, in setpoints
    uint16_t capabilities; // functions of the device (`Capability`)
    uint16_t skew_us; // time from one conversion to the next, and therefore from the conversion of channel 1 to the conversion of channel 0, in µs; rounded up
    uint16_t hold_us; // time from the trigger (t_us) to the hold of channel 0 and the latch of u, in µs
    uint8_t adc_bits; // resolution of the converter; readings are left-justified to 16 bits
    uint8_t pwm_bits; // resolution of the duty; 16 if the duty is not quantised
    uint8_t cause; // cause of the last change of state (`Cause`)
    uint8_t reset; // reset flags of the processor, unchanged (MCUSR)
    uint32_t crc; // CRC-32/ISO-HDLC of all bytes before it
} rig_hello_r_t;
_Static_assert(sizeof(rig_hello_r_t) == 52, "HELLO_R");
_Static_assert(sizeof(rig_hello_r_t) <= RIG_MAX_DECODED, "HELLO_R");

// Answer to CONFIG. It contains the configuration in force, also if CONFIG was refused.
#define RIG_TYPE_CONFIG_R 0x82U
typedef struct __attribute__((packed)) {
    uint8_t type;
    uint8_t state; // state of the device; 0 from a host (`State`)
    uint16_t seq; // number of the frame, counted by its sender
    uint8_t code; // OK, or the reason for the refusal (`Code`)
    uint8_t zero; // 0
    uint32_t config_crc; // CRC-32 of the CONFIG body in force; 0 if no configuration is in force
    uint32_t ts_us; // as in CONFIG, in µs
    uint16_t u_min; // as in CONFIG, in code
    uint16_t u_max; // as in CONFIG, in code
    uint16_t u_rest; // as in CONFIG, in code
    uint16_t slew; // as in CONFIG, in code
    uint16_t watchdog_ms; // as in CONFIG, in ms
    uint8_t mode; // as in CONFIG (`Mode`)
    uint8_t underrun; // as in CONFIG (`Underrun`)
    uint8_t hold; // as in CONFIG, in ticks
    uint8_t oversampling; // as in CONFIG
    uint16_t rail_ticks; // as in CONFIG, in samples
    uint16_t turns; // as in CONFIG, in turns/100
    uint32_t nonce; // nonce that ARM and START must contain; 0 if no configuration is in force
    uint32_t crc; // CRC-32/ISO-HDLC of all bytes before it
} rig_config_r_t;
_Static_assert(sizeof(rig_config_r_t) == 40, "CONFIG_R");
_Static_assert(sizeof(rig_config_r_t) <= RIG_MAX_DECODED, "CONFIG_R");

// Answer to ARM, START, STOP, CLEAR_FAULT, ESTOP, and to any frame that had no effect.
#define RIG_TYPE_ACK 0x83U
typedef struct __attribute__((packed)) {
    uint8_t type;
    uint8_t state; // state of the device; 0 from a host (`State`)
    uint16_t seq; // number of the frame, counted by its sender
    uint8_t of_type; // type of the frame answered
    uint8_t code; // OK, or the reason for the refusal (`Code`)
    uint16_t of_seq; // seq of the frame answered
    uint32_t crc; // CRC-32/ISO-HDLC of all bytes before it
} rig_ack_t;
_Static_assert(sizeof(rig_ack_t) == 12, "ACK");
_Static_assert(sizeof(rig_ack_t) <= RIG_MAX_DECODED, "ACK");

// The state changed.
#define RIG_TYPE_EVENT 0x84U
typedef struct __attribute__((packed)) {
    uint8_t type;
    uint8_t state; // state of the device; 0 from a host (`State`)
    uint16_t seq; // number of the frame, counted by its sender
    uint16_t boot; // low half of boot_id
    uint8_t was; // state before (`State`)
    uint8_t cause; // reason for the change (`Cause`)
    uint32_t t_us; // device clock, in µs
    uint32_t token; // token that CLEAR_FAULT must contain; 0 outside FAULT and ESTOP
    uint32_t detail; // RANGE and SLEW: the code refused; VCC_LOW: the supply in mV; else 0
    uint32_t crc; // CRC-32/ISO-HDLC of all bytes before it
} rig_event_t;
_Static_assert(sizeof(rig_event_t) == 24, "EVENT");
_Static_assert(sizeof(rig_event_t) <= RIG_MAX_DECODED, "EVENT");

// Counters since boot, once a second.
#define RIG_TYPE_STATUS 0x85U
typedef struct __attribute__((packed)) {
    uint8_t type;
    uint8_t state; // state of the device; 0 from a host (`State`)
    uint16_t seq; // number of the frame, counted by its sender
    uint16_t boot; // low half of boot_id
    uint16_t vcc_mv; // last measured supply, in mV; 0 if the device has not measured it
    uint32_t uptime_ms; // time since the reset, in ms
    uint32_t frames; // valid frames received
    uint32_t spoilt; // frames dropped because of COBS, length or CRC
    uint32_t refused; // valid frames without effect
    uint16_t rx_lost; // bytes lost in reception
    uint16_t tx_dropped; // frames not sent
    uint16_t late; // samples taken late
    uint16_t underruns; // samples without a setpoint
    uint16_t isr_max_us; // longest interrupt, in µs
    uint16_t stack_free; // smallest free stack since boot, in B
    uint32_t crc; // CRC-32/ISO-HDLC of all bytes before it
} rig_status_t;
_Static_assert(sizeof(rig_status_t) == 40, "STATUS");
_Static_assert(sizeof(rig_status_t) <= RIG_MAX_DECODED, "STATUS");

// Readings of both potentiometers, and the input latched at the last conversion.
#define RIG_TYPE_SAMPLE 0x90U
typedef struct __attribute__((packed)) {
    uint8_t type;
    uint8_t state; // state of the device; 0 from a host (`State`)
    uint16_t seq; // number of the frame, counted by its sender
    uint16_t boot; // low half of boot_id, by which the host notices every reset
    uint16_t echo; // seq of the newest host frame taken in
    uint16_t u_seq; // seq of the frame that contained u_k; 0 if no frame contained u_k
    uint32_t k; // sample index: k of the EXCHANGE, or in scheduled mode counted from 0 at START
    uint32_t t_us; // device clock when the conversion of channel 0 is triggered, in µs; wraps after 71.6 min
    uint16_t y0; // channel 0, left-justified to 16 bits, in counts
    uint16_t y1; // channel 1, left-justified to 16 bits, in counts
    uint16_t u_k; // code of the duty that the motor has from sample k on, in code
    uint16_t u_km1; // code in force just before the latch, in code; if the previous SAMPLE is lost, it shows the u_k of the lost SAMPLE
    uint16_t flags; // conditions of the sample (`Flag`)
    uint16_t queued; // setpoints in the queue after the latch
    uint32_t crc; // CRC-32/ISO-HDLC of all bytes before it
} rig_sample_t;
_Static_assert(sizeof(rig_sample_t) == 34, "SAMPLE");
_Static_assert(sizeof(rig_sample_t) <= RIG_MAX_DECODED, "SAMPLE");

// The device's clock.
#define RIG_TYPE_PONG 0x92U
typedef struct __attribute__((packed)) {
    uint8_t type;
    uint8_t state; // state of the device; 0 from a host (`State`)
    uint16_t seq; // number of the frame, counted by its sender
    uint64_t host_ns; // value of host_ns in PING, in ns
    uint32_t rx_us; // device clock after PING was received, in µs
    uint32_t tx_us; // device clock at which the first byte of PONG leaves, in µs
    uint32_t crc; // CRC-32/ISO-HDLC of all bytes before it
} rig_pong_t;
_Static_assert(sizeof(rig_pong_t) == 24, "PONG");
_Static_assert(sizeof(rig_pong_t) <= RIG_MAX_DECODED, "PONG");

// Statistics of raw readings.
#define RIG_TYPE_CAL_R 0x94U
typedef struct __attribute__((packed)) {
    uint8_t type;
    uint8_t state; // state of the device; 0 from a host (`State`)
    uint16_t seq; // number of the frame, counted by its sender
    uint8_t channel; // channel of the CAL
    uint8_t zero; // 0
    uint16_t n; // readings taken
    uint32_t mean_256; // mean of the readings, in counts/256
    uint32_t variance_256; // variance of the readings, with the divisor n - 1, in counts²/256; at most 2^32 - 1, and 0 for n = 1
    uint16_t least; // smallest reading, in counts
    uint16_t greatest; // largest reading, in counts
    uint32_t crc; // CRC-32/ISO-HDLC of all bytes before it
} rig_cal_r_t;
_Static_assert(sizeof(rig_cal_r_t) == 24, "CAL_R");
_Static_assert(sizeof(rig_cal_r_t) <= RIG_MAX_DECODED, "CAL_R");

#endif
