#include "rig_frame.h"

#include <string.h>

#include "rig_cobs.h" // rig_stuff
#include "rig_crc.h" // rig_crc

enum { CRC_BYTES = 4 };

uint8_t rig_length(uint8_t type)
{
    switch (type) { // unlike a table, a switch needs no RAM
    case RIG_TYPE_HELLO: return sizeof(rig_hello_t);
    case RIG_TYPE_CONFIG: return sizeof(rig_config_t);
    case RIG_TYPE_ARM: return sizeof(rig_arm_t);
    case RIG_TYPE_START: return sizeof(rig_start_t);
    case RIG_TYPE_STOP: return sizeof(rig_stop_t);
    case RIG_TYPE_CLEAR_FAULT: return sizeof(rig_clear_fault_t);
    case RIG_TYPE_ESTOP: return sizeof(rig_estop_t);
    case RIG_TYPE_EXCHANGE: return sizeof(rig_exchange_t);
    case RIG_TYPE_SETPOINTS: return sizeof(rig_setpoints_t);
    case RIG_TYPE_PING: return sizeof(rig_ping_t);
    case RIG_TYPE_KEEPALIVE: return sizeof(rig_keepalive_t);
    case RIG_TYPE_CAL: return sizeof(rig_cal_t);
    case RIG_TYPE_HELLO_R: return sizeof(rig_hello_r_t);
    case RIG_TYPE_CONFIG_R: return sizeof(rig_config_r_t);
    case RIG_TYPE_ACK: return sizeof(rig_ack_t);
    case RIG_TYPE_EVENT: return sizeof(rig_event_t);
    case RIG_TYPE_STATUS: return sizeof(rig_status_t);
    case RIG_TYPE_SAMPLE: return sizeof(rig_sample_t);
    case RIG_TYPE_PONG: return sizeof(rig_pong_t);
    case RIG_TYPE_CAL_R: return sizeof(rig_cal_r_t);
    default: return 0;
    }
}

uint8_t rig_close(union rig_frame *frame, uint8_t length)
{
    const uint32_t crc = rig_crc(frame->message.bytes, length - CRC_BYTES);
    memcpy(frame->message.bytes + length - CRC_BYTES, &crc, CRC_BYTES);
    rig_stuff(frame->wire, length + 1);
    frame->wire[length + 1] = 0;
    return length + 2;
}

enum rig_opened rig_open(union rig_frame *frame, uint8_t n)
{
    if (n > RIG_LONGEST_STUFFED)
        return RIG_SPOILT_LENGTH;
    if (!rig_unstuff(frame->wire, n))
        return RIG_SPOILT_COBS;
    const uint8_t length = n - 1; // without the overhead byte
    if (length < sizeof(struct rig_header) + CRC_BYTES)
        return RIG_SPOILT_LENGTH;
    const uint32_t crc = rig_crc(frame->message.bytes, length - CRC_BYTES);
    if (memcmp(frame->message.bytes + length - CRC_BYTES, &crc, CRC_BYTES) != 0)
        return RIG_SPOILT_CRC;
    const uint8_t expected = rig_length(frame->message.header.type);
    if (expected == 0)
        return RIG_UNKNOWN;
    return length == expected ? RIG_SOUND : RIG_SPOILT_LENGTH;
}
