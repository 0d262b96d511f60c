// What each frame of the host does (PROTOCOL.md, sections 2 to 6).
#ifndef RIG_REQUESTS_H
#define RIG_REQUESTS_H

#include "rig_frame.h"

// Does what a sound frame asks for.
void rig_take(const union rig_message *m);

// Answers a sound frame of a type that the schema does not have.
void rig_refuse_unknown(const union rig_message *m);

#endif
