#include "rig_setpoints.h"

#include "rig_state.h" // rig
#include "rig_states.h" // rig_enter
#include "rig_transmission.h" // rig_answer

// Enters FAULT because of the code `refused`.
static void trip(uint8_t cause, uint16_t refused)
{
    rig_enter(RIG_STATE_FAULT, cause, refused);
    rig_tell_transition();
}

void rig_take_setpoints(const union rig_message *m)
{
    if (!(BOARD_CAPABILITIES & RIG_CAPABILITY_SCHEDULED)) {
        rig_answer(&m->header, RIG_CODE_UNSUPPORTED);
        return;
    }
    if (!rig_is_bound() || rig.config.mode != RIG_MODE_SCHEDULED) {
        rig_answer(&m->header, RIG_CODE_WRONG_STATE);
        return;
    }
    if (m->setpoints.n < 1 || m->setpoints.n > RIG_SETPOINTS_PER_FRAME || m->setpoints.zero != 0) {
        rig_answer(&m->header, RIG_CODE_BAD_VALUE);
        return;
    }
    uint16_t refused = 0;
    switch (rig_queue_put(&rig.queue, &rig.config, &m->setpoints, &refused)) {
    case RIG_PUT: break;
    case RIG_PUT_DISAGREES: rig_answer(&m->header, RIG_CODE_BAD_VALUE); break;
    case RIG_PUT_OUT_OF_RANGE: trip(RIG_CAUSE_RANGE, refused); break;
    case RIG_PUT_TOO_STEEP: trip(RIG_CAUSE_SLEW, refused); break;
    }
}
