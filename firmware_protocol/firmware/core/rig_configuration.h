// What the device accepts as a configuration (PROTOCOL.md, section 4).
#ifndef RIG_CONFIGURATION_H
#define RIG_CONFIGURATION_H

#include <stddef.h>

#include "rig_frame.h"

// Length of a CONFIG's body, which CONFIG_R carries, too.
enum { RIG_CONFIG_BODY = offsetof(rig_config_t, crc) - offsetof(rig_config_t, ts_us) };
_Static_assert(
    RIG_CONFIG_BODY == offsetof(rig_config_r_t, nonce) - offsetof(rig_config_r_t, ts_us), "the same");

// Returns OK, or why this board refuses a configuration.
uint8_t rig_check_config(const rig_config_t *m);

// Returns the CRC-32 of its body, by which ARM names it.
uint32_t rig_config_crc(const rig_config_t *m);

#endif
