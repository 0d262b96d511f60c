// Samples: the latch of u, the guards and SAMPLE (PROTOCOL.md, sections 5 to 7). board.h declares
// `rig_oversampling`, `rig_reading`, `rig_latch`, `rig_converted` and `rig_end`.
#ifndef RIG_SAMPLING_H
#define RIG_SAMPLING_H

#include <stdbool.h>

#include "rig_frame.h"

// Requests the sample of an EXCHANGE from the board. The caller has checked that there is room. If
// `drives` is true, the sample latches u. Called from main.
void rig_ask(const rig_exchange_t *m, bool drives);

// Sends the samples that were taken, and trips if a guard requires a trip. Then leaves RUN if the
// run has ended. Called from main.
void rig_tell_samples(void);

#endif
