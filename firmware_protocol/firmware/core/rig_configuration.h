// The check of a configuration (PROTOCOL.md, section 4).
#ifndef RIG_CONFIGURATION_H
#define RIG_CONFIGURATION_H

#include <stddef.h>

#include "rig_frame.h"

// Length of the body of CONFIG. CONFIG_R contains the same fields.
enum { RIG_CONFIG_BODY = offsetof(rig_config_t, crc) - offsetof(rig_config_t, ts_us) };
_Static_assert(
    RIG_CONFIG_BODY == offsetof(rig_config_r_t, nonce) - offsetof(rig_config_r_t, ts_us), "the same");

// Returns OK, or the code with which this board refuses the configuration.
uint8_t rig_check_config(const rig_config_t *m);

// Returns the CRC-32 of the body of CONFIG. ARM identifies a configuration by this CRC.
uint32_t rig_config_crc(const rig_config_t *m);

#endif
