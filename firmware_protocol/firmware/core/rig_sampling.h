// Samples: the latch of u, the guards, SAMPLE (PROTOCOL.md, sections 5 to 7).
// `rig_oversampling`, `rig_reading`, `rig_latch`, `rig_converted` and `rig_end` are in board.h.
#ifndef RIG_SAMPLING_H
#define RIG_SAMPLING_H

#include <stdbool.h>

#include "rig_frame.h"

// Asks the board for the sample of an EXCHANGE; there is room for it. From main.
void rig_ask(const rig_exchange_t *m, bool drives);

// Tells the samples that were taken, and the guard that trips; then the end of the run. From main.
void rig_tell_samples(void);

#endif
