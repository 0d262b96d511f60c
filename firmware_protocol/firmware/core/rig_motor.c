#include "rig_motor.h"

#include "rig_state.h" // rig

_Static_assert((BOARD_PWM_BITS >= 8 && BOARD_PWM_BITS <= 16), "duty");

uint16_t rig_duty(uint16_t code)
{
#if BOARD_PWM_BITS == 16
    return code;
#else
    // round(code 2^bits / 65535). For each such x, x / 65535 is (x + 1 + x / 65536) / 65536.
    const uint32_t x = ((uint32_t)code << BOARD_PWM_BITS) + RIG_CODE_FULL_SCALE / 2;
    return (x + 1 + (x >> 16)) >> 16;
#endif
}

uint16_t rig_code(uint16_t duty)
{
#if BOARD_PWM_BITS == 16
    return duty;
#else
    // round(duty 65535 / 2^bits), without a multiplication
    const uint32_t x = ((uint32_t)duty << 16) - duty;
    return (x + (1UL << (BOARD_PWM_BITS - 1))) >> BOARD_PWM_BITS;
#endif
}

void rig_motor_cut(void)
{
    board_motor_off();
    const uint8_t before = board_irq_save();
    rig.motor.live = false;
    board_motor_off(); // again: an interrupt may have latched a code in between
    rig.motor.duty = 0;
    rig.motor.u_seq = 0;
    board_irq_restore(before);
}

// Drives the motor. No other function calls board_motor_set. The caller is an interrupt, or main
// with interrupts off.
static void drive(uint16_t u, uint16_t u_seq)
{
    if (rig.state != RIG_STATE_RUN || !rig.motor.live)
        return;
    const rig_config_t *config = &rig.config;
    if (u != config->u_rest && (u < config->u_min || u > config->u_max)) {
        rig_motor_cut();
        rig.motor.broken = true; // main then enters FAULT(INTERNAL)
        return;
    }
    rig.motor.duty = rig_duty(u);
    rig.motor.u_seq = u_seq;
    board_motor_set(rig.motor.duty);
}

void rig_motor_begin(uint16_t u_seq)
{
    const uint8_t before = board_irq_save();
    rig.motor.live = true;
    drive(rig.config.u_rest, u_seq);
    board_irq_restore(before);
}

void rig_motor_latch(uint16_t u, uint16_t u_seq)
{
    drive(u, u_seq);
}
