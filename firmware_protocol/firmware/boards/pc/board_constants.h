// The constants of the board on a PC, which runs in virtual time. The defaults are those of
// `armrigd emulate`.
#ifndef BOARD_CONSTANTS_H
#define BOARD_CONSTANTS_H

#ifndef BOARD_QUEUE
#define BOARD_QUEUE 512
#endif
#ifndef BOARD_ADC_BITS
#define BOARD_ADC_BITS 10
#endif
#ifndef BOARD_PWM_BITS
#define BOARD_PWM_BITS 10
#endif
#ifndef BOARD_SKEW_US
#define BOARD_SKEW_US 104
#endif
#define BOARD_HOLD_US 12
#ifndef BOARD_TS_MIN_US
#define BOARD_TS_MIN_US 208
#endif
#define BOARD_CAPABILITIES \
    (RIG_CAPABILITY_EXCHANGE | RIG_CAPABILITY_SCHEDULED | RIG_CAPABILITY_CAL \
        | RIG_CAPABILITY_ENABLE_LINE)
#define BOARD_RAM 3500

// This board has no interrupts: the emulated hardware calls the core in one thread. `interrupts.c`
// is the exception, and defines its own functions.
#ifndef PC_INTERRUPTS
#define BOARD_IRQ_INLINE
static inline unsigned char board_irq_save(void) { return 0; }
static inline void board_irq_restore(unsigned char before) { (void)before; }
#endif

#endif
