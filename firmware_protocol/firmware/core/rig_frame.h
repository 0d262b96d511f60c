// A frame: one message of the protocol with its header, CRC and stuffing.
#ifndef RIG_FRAME_H
#define RIG_FRAME_H

#include "../rig_protocol.h"

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "the structures lie as the wire carries them");

struct __attribute__((packed)) rig_header {
    uint8_t type;
    uint8_t state;
    uint16_t seq;
};

// A message: the bytes of a frame before stuffing.
union rig_message {
    uint8_t bytes[RIG_MAX_DECODED];
    struct rig_header header;
    rig_hello_t hello;
    rig_config_t config;
    rig_arm_t arm;
    rig_start_t start;
    rig_clear_fault_t clear_fault;
    rig_exchange_t exchange;
    rig_setpoints_t setpoints;
    rig_ping_t ping;
    rig_cal_t cal;
    rig_hello_r_t hello_r;
    rig_config_r_t config_r;
    rig_ack_t ack;
    rig_event_t event;
    rig_status_t status;
    rig_sample_t sample;
    rig_pong_t pong;
    rig_cal_r_t cal_r;
};
_Static_assert(sizeof(union rig_message) == RIG_MAX_DECODED, "message");

// A frame on the wire: one byte of overhead, the stuffed message, and a 00.
union rig_frame {
    uint8_t wire[RIG_MAX_DECODED + 2];
    struct __attribute__((packed)) {
        uint8_t overhead;
        union rig_message message;
    };
};
_Static_assert(sizeof(union rig_frame) == RIG_MAX_DECODED + 2, "frame");

enum { RIG_LONGEST_STUFFED = RIG_MAX_DECODED + 1 }; // without the 00 at the end

enum rig_opened {
    RIG_SOUND,
    RIG_UNKNOWN, // valid frame of a type that the schema does not contain
    RIG_SPOILT_COBS,
    RIG_SPOILT_LENGTH,
    RIG_SPOILT_CRC,
};

// Returns the decoded length of a type, header and CRC included; 0 for an unknown type.
uint8_t rig_length(uint8_t type);

// Adds the CRC to a message of `length` bytes, CRC included. Then stuffs the frame, appends the 00
// and returns the length on the wire.
uint8_t rig_close(union rig_frame *frame, uint8_t length);

// Unstuffs and checks the `n` bytes between two 00.
enum rig_opened rig_open(union rig_frame *frame, uint8_t n);

#endif
