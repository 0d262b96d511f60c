// STATUS: the counters since boot, sent once a second.
#ifndef RIG_STATUS_H
#define RIG_STATUS_H

#include <stdint.h>

// Starts the uptime. It counts from the reset, at which the board's clock was 0.
void rig_status_begin(void);

// Sends STATUS if STATUS is due.
void rig_tell_status(void);

// Counts received bytes that were lost for lack of room.
void rig_count_lost(uint16_t bytes);

#endif
