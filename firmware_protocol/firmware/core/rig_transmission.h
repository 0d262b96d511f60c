// Frames to the host: numbered, closed, given to the board.
#ifndef RIG_TRANSMISSION_H
#define RIG_TRANSMISSION_H

#include "rig_frame.h"

// Returns the place for the next frame's message, its body filled with 0.
union rig_message *rig_blank(void);

// Sends it as `type`; a frame that finds no room is dropped and counted, and leaves a break in seq.
void rig_send(uint8_t type);

// Sends the 00 that a sender begins with.
void rig_send_break(void);

// Sends ACK of the frame `of`; what is not OK had no effect, and is counted.
void rig_answer(const struct rig_header *of, uint8_t code);

#endif
