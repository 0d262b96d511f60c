// What the core asks of a board, and what a board tells the core. A board is one folder in boards/:
// `board_constants.h` with the numbers below, and the functions.
//
// Two contexts. "Main" is the endless loop; "interrupt" is an interrupt's handler, and interrupts
// do not nest. A board without interrupts calls both from one place.
#ifndef BOARD_H
#define BOARD_H

#include <stdbool.h>
#include <stdint.h>

// `board_constants.h` defines, as integer constants:
//   BOARD_QUEUE              setpoints held ahead; a power of two, 64 ... RIG_QUEUE_CAPACITY
//   BOARD_ADC_BITS           of the converter
//   BOARD_PWM_BITS           of the duty, 8 ... 15; 16: a duty of 65535 steps that is the code itself
//   BOARD_SKEW_US            from alpha's trigger to theta_1's
//   BOARD_HOLD_US            from theta_1's trigger to its hold, at which u is latched
//   BOARD_TS_MIN_US          shortest Ts
//   BOARD_CAPABILITIES       of RIG_CAPABILITY_...
//   BOARD_RAM                bytes of RAM that the core may take
#include "board_constants.h"

// ------------------------------------------------------------- asked of a board: motor
// 0 V: the PWM pin disconnected and driven low, the enable line low. From both contexts, at any
// time, as often as one likes; it takes effect before it returns.
void board_motor_off(void);

// Drives the motor with `duty` of 2^BOARD_PWM_BITS steps; 0 is the pin disconnected and low with
// the enable line high. Called in RUN alone, with interrupts off. 2^BOARD_PWM_BITS is always high.
void board_motor_set(uint16_t duty);

// ------------------------------------------------------------- asked of a board: time
// The device's clock; starts at reset, wraps at 2^32. From both contexts.
uint32_t board_now_us(void);

// ------------------------------------------------------------- asked of a board: converter
// A sample is 2 m conversions, alpha, theta_1, alpha, theta_1 ..., each triggered BOARD_SKEW_US after
// the one before; m is what `rig_oversampling` says when the first is triggered. Samples are taken in
// the order in which they were asked for or fell due; one that has to wait begins when the one
// before it has ended.

// Takes a sample as soon as the converter is free. At most two of these wait or are under way at a
// time. From main, interrupts on.
void board_convert_now(void);

// Takes samples k = 0, 1, ...; the last conversion of each, theta_1's, is triggered at t0_us + k ts_us,
// without drift. `k_stop` not 0: sample k_stop is not taken; instead `rig_end` is called at
// t0_us + k_stop ts_us + BOARD_HOLD_US, and the timer stops. From main, interrupts on; t0_us is one
// Ts away.
void board_timer_start(uint32_t t0_us, uint32_t ts_us, uint32_t k_stop);

// No further sample falls due; what has been triggered, or waits for the converter, is finished.
// From main; also where no timer runs.
void board_timer_stop(void);

// Returns whether no sample is under way or waits. From main.
bool board_converter_is_free(void);

// Takes `n` conversions of one channel, 0 theta_1 or 1 alpha, BOARD_SKEW_US apart, from now on. The
// converter is free, and no timer runs. From main.
void board_convert_channel(uint8_t channel, uint16_t n);

// Measures the supply when the converter is free and no sample has to wait for it, and calls
// `rig_supply`; a board that cannot does nothing. From main.
void board_measure_supply(void);

// ------------------------------------------------------------- asked of a board: bytes out
// Puts `n` bytes behind those that wait to leave, or none and returns false where they find no room.
// Never waits. From main.
bool board_send(const uint8_t *bytes, uint8_t n);

// Device clock at which the first byte of the next `board_send` will begin to leave. From main.
uint32_t board_send_us(void);

// ------------------------------------------------------------- asked of a board: what it is and saw
uint64_t board_uid(void); // of this piece of hardware
uint32_t board_boot_id(void); // drawn at each boot, not 0; asked for once, by `rig_begin`
uint32_t board_token(void); // drawn at each call, not 0
uint32_t board_firmware_crc(void); // CRC-32 of the firmware's image
uint8_t board_reset_flags(void); // of the processor as it gives them
uint16_t board_isr_max_us(void); // longest interrupt since boot
uint16_t board_stack_free(void); // least stack left since boot
uint16_t board_rx_lost(void); // bytes lost in reception since the last call
void board_feed_watchdog(void); // the hardware's; called by `rig_poll`

// ------------------------------------------------------------- asked of a board: interrupts
// Off, and as they were before; the compiler must move no access to memory across either. The core
// keeps them off for no longer than it takes to copy a few words. Functions, or inline ones in
// `board_constants.h` with BOARD_IRQ_INLINE defined.
#ifndef BOARD_IRQ_INLINE
uint8_t board_irq_save(void);
void board_irq_restore(uint8_t before);
#endif

// ------------------------------------------------------------- told by a board
// Once, when time, converter, motor, and both directions of bytes work; the motor is off already.
void rig_begin(void);

// A byte has come. From main, in the order of arrival.
void rig_receive(uint8_t byte);

// As often as possible, from main: watchdog, samples to be told, STATUS. Call it before each byte
// that is given to `rig_receive`, so that a sample never waits behind a burst of bytes.
void rig_poll(void);

// What a sample is; the board says so in each call that belongs to it.
enum {
    RIG_ASKED = 0, // by board_convert_now
    RIG_TIMED = 1, // by board_timer_start
    RIG_LATE = 2, // with either: its conversions had to wait for those of another
};

// Returns m of a sample whose first conversion is triggered now. From both contexts.
uint8_t rig_oversampling(void);

// A conversion has ended, of a sample or of board_convert_channel: channel 0 is theta_1, 1 alpha; the
// code is left-justified to 16 bits. From an interrupt.
void rig_reading(uint8_t channel, uint16_t code);

// theta_1 is being held for its last conversion: u acts now. From an interrupt at that instant.
void rig_latch(uint8_t what);

// All conversions of a sample have ended and were told; t_us is the trigger of the last. After its
// rig_latch. From an interrupt.
void rig_converted(uint8_t what, uint32_t t_us);

// The last input was held for its whole Ts: the motor goes off. From an interrupt at that instant.
void rig_end(void);

// The supply was measured. From an interrupt, or at once from board_measure_supply.
void rig_supply(uint16_t mv);

#endif
