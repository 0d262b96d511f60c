#include <stdbool.h>

#include "rig_configuration.h"

#include "board.h"
#include "rig_crc.h" // rig_crc

// Returns true if this board allows the value of each field. Otherwise the code is BAD_VALUE.
static bool is_allowed(const rig_config_t *m)
{
    const bool has_enable = BOARD_CAPABILITIES & RIG_CAPABILITY_ENABLE_LINE;
    const uint32_t ts_min_us = BOARD_TS_MIN_US + 2UL * BOARD_SKEW_US * (m->oversampling - 1);
    return m->oversampling >= 1 && m->ts_us >= ts_min_us && m->u_min <= m->u_max
        && (m->u_rest == 0 || (has_enable && m->u_min <= m->u_rest && m->u_rest <= m->u_max))
        && m->watchdog_ms >= RIG_WATCHDOG_MIN_MS && m->watchdog_ms <= RIG_WATCHDOG_MAX_MS
        && m->mode <= RIG_MODE_SCHEDULED && m->underrun <= RIG_UNDERRUN_HOLD;
}

uint8_t rig_check_config(const rig_config_t *m)
{
    if (!is_allowed(m))
        return RIG_CODE_BAD_VALUE;
    const bool has_timer = BOARD_CAPABILITIES & RIG_CAPABILITY_SCHEDULED;
    if (m->mode == RIG_MODE_SCHEDULED && !has_timer)
        return RIG_CODE_UNSUPPORTED;
    return RIG_CODE_OK;
}

uint32_t rig_config_crc(const rig_config_t *m)
{
    return rig_crc((const uint8_t *)&m->ts_us, RIG_CONFIG_BODY);
}
