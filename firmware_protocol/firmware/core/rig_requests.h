// Execution of the host's frames (PROTOCOL.md, sections 2 to 6).
#ifndef RIG_REQUESTS_H
#define RIG_REQUESTS_H

#include "rig_frame.h"

// Executes a valid frame, or answers STALE.
void rig_take(const union rig_message *m);

// Answers a valid frame of a type that the schema does not contain.
void rig_refuse_unknown(const union rig_message *m);

#endif
