// What SETPOINTS does (PROTOCOL.md, section 6).
#ifndef RIG_SETPOINTS_H
#define RIG_SETPOINTS_H

#include "rig_frame.h"

// Puts the setpoints into the queue; what is right or merely late or early has no answer.
void rig_take_setpoints(const union rig_message *m);

#endif
