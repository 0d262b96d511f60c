// Execution of SETPOINTS (PROTOCOL.md, section 6).
#ifndef RIG_SETPOINTS_H
#define RIG_SETPOINTS_H

#include "rig_frame.h"

// Puts the setpoints into the queue. Valid setpoints have no answer, even if they are late or
// follow a gap.
void rig_take_setpoints(const union rig_message *m);

#endif
