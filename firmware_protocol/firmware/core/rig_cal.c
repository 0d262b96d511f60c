#include "rig_cal.h"

#include "rig_state.h" // rig
#include "rig_transmission.h" // rig_answer

enum { MOST_READINGS = 1024 };

void rig_take_cal(const union rig_message *m)
{
    if (!(BOARD_CAPABILITIES & RIG_CAPABILITY_CAL)) {
        rig_answer(&m->header, RIG_CODE_UNSUPPORTED);
        return;
    }
    const bool is_at_rest = rig.state == RIG_STATE_IDLE || rig.state == RIG_STATE_READY;
    if (!is_at_rest || rig.cal.is_under_way || !board_converter_is_free()) {
        rig_answer(&m->header, RIG_CODE_WRONG_STATE);
        return;
    }
    const rig_cal_t *cal = &m->cal;
    if (cal->channel > 1 || cal->zero != 0 || cal->n < 1 || cal->n > MOST_READINGS) {
        rig_answer(&m->header, RIG_CODE_BAD_VALUE);
        return;
    }
    rig.cal = (struct rig_cal){
        .n = cal->n,
        .left = cal->n,
        .least = UINT16_MAX,
        .is_under_way = true,
        .channel = cal->channel,
    };
    board_convert_channel(cal->channel, cal->n);
}

void rig_cal_add(uint16_t code)
{
    struct rig_cal *cal = &rig.cal;
    cal->sum += code;
    cal->squares += (uint32_t)code * code;
    if (code < cal->least)
        cal->least = code;
    if (code > cal->greatest)
        cal->greatest = code;
    cal->left--;
}

// Returns the variance over n - 1, in counts^2/256, a tie rounded up. For 1024 codes, 256 `spread`
// needs 60 bits.
static uint32_t variance_256(const struct rig_cal *cal)
{
    const uint32_t pairs = (uint32_t)cal->n * (cal->n - 1U);
    if (pairs == 0)
        return 0;
    const uint64_t spread = cal->n * cal->squares - (uint64_t)cal->sum * cal->sum;
    const uint64_t variance = (256 * spread + pairs / 2) / pairs;
    return variance < UINT32_MAX ? (uint32_t)variance : UINT32_MAX;
}

void rig_tell_cal(void)
{
    const struct rig_cal *cal = &rig.cal;
    if (!cal->is_under_way)
        return;
    const uint8_t before = board_irq_save();
    const uint16_t left = cal->left;
    board_irq_restore(before);
    if (left)
        return;
    rig.cal.is_under_way = false;
    rig_cal_r_t *m = &rig_blank()->cal_r;
    m->channel = cal->channel;
    m->n = cal->n;
    m->mean_256 = (uint32_t)((256ULL * cal->sum + cal->n / 2) / cal->n);
    m->variance_256 = variance_256(cal);
    m->least = cal->least;
    m->greatest = cal->greatest;
    rig_send(RIG_TYPE_CAL_R);
}
