#include "rig_guards.h"

#include "../rig_protocol.h"

enum { RAIL_CODES = 64 }; // 1/1024 of the range of 65536 codes

bool rig_at_rail(uint16_t y)
{
    return y < RAIL_CODES || y >= 0x10000UL - RAIL_CODES;
}

// Returns the new number of successive samples at a rail, at most the largest possible limit.
static uint16_t counted(uint16_t in_a_row, uint16_t y)
{
    if (!rig_at_rail(y))
        return 0;
    return in_a_row < UINT16_MAX ? in_a_row + 1 : in_a_row;
}

// Returns true if |`codes`| is `turns`/100 turns or more. 65536 `turns` fits in 32 bits.
static bool too_far(int32_t codes, uint16_t turns)
{
    const uint32_t least = (((uint32_t)turns << 16) + 99) / 100;
    return (uint32_t)(codes < 0 ? -codes : codes) >= least;
}

uint8_t rig_watch(
    struct rig_guards *guards, uint16_t y0, uint16_t y1, uint16_t rail_ticks, uint16_t turns)
{
    guards->rails[0] = counted(guards->rails[0], y0);
    guards->rails[1] = counted(guards->rails[1], y1);
    // Without a limit, the rotation is not summed, so that the sum cannot overflow.
    if (guards->has_y0 && turns)
        guards->turned += (int16_t)(y0 - guards->y0);
    guards->y0 = y0;
    guards->has_y0 = true;
    if (rail_ticks && (guards->rails[0] >= rail_ticks || guards->rails[1] >= rail_ticks))
        return RIG_CAUSE_ADC_RAIL;
    if (turns && too_far(guards->turned, turns))
        return RIG_CAUSE_REV_LIMIT;
    return RIG_CAUSE_NONE;
}
