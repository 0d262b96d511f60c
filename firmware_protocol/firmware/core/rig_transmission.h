// Transmission: adds the number, the CRC and the stuffing to a frame, and passes it to the board.
#ifndef RIG_TRANSMISSION_H
#define RIG_TRANSMISSION_H

#include "rig_frame.h"

// Returns the message of the next frame to be sent, filled with 0.
union rig_message *rig_blank(void);

// Sends the message of `rig_blank` as `type`. If the board has no room, the frame is dropped and
// counted, and its seq is missing at the host.
void rig_send(uint8_t type);

// Sends the additional 00 with which a sender starts.
void rig_send_break(void);

// Sends ACK for the frame `of`. If the code is not OK, the frame is counted as refused.
void rig_answer(const struct rig_header *of, uint8_t code);

#endif
