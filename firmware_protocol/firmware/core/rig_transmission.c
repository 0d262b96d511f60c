#include "rig_transmission.h"

#include <string.h>

#include "rig_state.h" // rig

union rig_message *rig_blank(void)
{
    memset(&rig.tx, 0, sizeof rig.tx);
    return &rig.tx.message;
}

void rig_send(uint8_t type)
{
    rig.tx.message.header = (struct rig_header){.type = type, .state = rig.state, .seq = rig.tx_seq++};
    if (!board_send(rig.tx.wire, rig_close(&rig.tx, rig_length(type)))) {
        if (rig.counters.tx_dropped < UINT16_MAX)
            rig.counters.tx_dropped++;
        rig.new_flags |= RIG_FLAG_TX_DROP;
    }
}

void rig_send_break(void)
{
    static const uint8_t ending = 0;
    board_send(&ending, sizeof ending);
}

void rig_answer(const struct rig_header *of, uint8_t code)
{
    if (code != RIG_CODE_OK)
        rig.counters.refused++;
    rig_ack_t *m = &rig_blank()->ack;
    m->of_type = of->type;
    m->code = code;
    m->of_seq = of->seq;
    rig_send(RIG_TYPE_ACK);
}
