// STATUS: the counters, once a second.
#ifndef RIG_STATUS_H
#define RIG_STATUS_H

#include <stdint.h>

// Begins to count the uptime; the board's clock began with 0 at the reset.
void rig_status_begin(void);

// Sends STATUS where it is due.
void rig_tell_status(void);

// Counts received bytes that found no room.
void rig_count_lost(uint16_t bytes);

#endif
