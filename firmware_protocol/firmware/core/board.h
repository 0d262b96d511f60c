// The contract between the core and a board. A board is a folder in boards/. It contains
// `board_constants.h` with the constants below, and the functions that the core calls.
//
// There are two contexts. "Main" is the endless loop; "interrupt" is an interrupt handler. A
// handler may enable interrupts while it calls the core. A call must not interrupt another call of
// the same function. A board without interrupts calls the functions of both contexts from one loop.
#ifndef BOARD_H
#define BOARD_H

#include <stdbool.h>
#include <stdint.h>

// `board_constants.h` defines, as integer constants:
//   BOARD_QUEUE              capacity in setpoints; a power of two, 64 ... RIG_QUEUE_CAPACITY
//   BOARD_ADC_BITS           resolution of the converter
//   BOARD_PWM_BITS           resolution of the duty, 8 ... 15; with 16 the duty is the code itself
//   BOARD_SKEW_US            time from the trigger of channel 1 to the trigger of channel 0
//   BOARD_HOLD_US            time from the trigger of channel 0 to its hold, at which u is latched
//   BOARD_TS_MIN_US          shortest Ts with oversampling 1
//   BOARD_CAPABILITIES       flags RIG_CAPABILITY_...
//   BOARD_RAM                bytes of RAM that `struct rig` may occupy
#include "board_constants.h"

// ------------------------------------------------------------- functions of a board: motor
// Sets the motor to 0 V: the PWM pin is disconnected and driven low, and the enable line is low.
// Both contexts call the function at any time, any number of times. 0 V is in effect before the
// function returns.
void board_motor_off(void);

// Drives the motor with a duty of `duty` steps out of 2^BOARD_PWM_BITS. With 0 the pin is
// disconnected and low, and the enable line is high. With 2^BOARD_PWM_BITS the pin is always high.
// The core calls the function only in RUN, from an interrupt or with interrupts off.
void board_motor_set(uint16_t duty);

// ------------------------------------------------------------- functions of a board: time
// Returns the device's clock, which starts at reset and wraps at 2^32. Called from both contexts.
uint32_t board_now_us(void);

// ------------------------------------------------------------- functions of a board: converter
// A sample consists of 2 m conversions: channel 1, channel 0, channel 1, channel 0 ... Each
// conversion is triggered BOARD_SKEW_US after the previous conversion. The oversampling m is the value of
// `rig_oversampling` when the first conversion is triggered. The board takes samples in the order
// in which they were requested or fell due. A sample that must wait begins when the previous sample
// has ended.

// Requests a sample, which the board takes as soon as the converter is free. At most two requested
// samples wait or are in progress at a time. Called from main, with interrupts on.
void board_convert_now(void);

// Starts the timer, which takes samples k = 0, 1, ... The last conversion of sample k, of channel 0,
// is triggered at t0_us + k ts_us, without drift. If `k_stop` is not 0, sample k_stop is not taken.
// Instead, the board calls `rig_end` at t0_us + k_stop ts_us + BOARD_HOLD_US and stops the timer.
// Called from main, with interrupts on, one Ts before t0_us.
void board_timer_start(uint32_t t0_us, uint32_t ts_us, uint32_t k_stop);

// Stops the timer, if it runs. A sample that was triggered is finished, and requested samples that
// wait are taken. Called from main.
void board_timer_stop(void);

// Returns true if no sample is in progress or waits, and the converter is not in use for the
// supply. Called from main.
bool board_converter_is_free(void);

// Starts `n` conversions of one channel (0 or 1), BOARD_SKEW_US apart. The core calls
// the function only while the converter is free and the timer is stopped. Called from main.
void board_convert_channel(uint8_t channel, uint16_t n);

// Requests a measurement of the supply. The board measures when the converter is free and no sample
// must wait for it, and then calls `rig_supply`. A board that cannot measure the supply does
// nothing. Called from main.
void board_measure_supply(void);

// ------------------------------------------------------------- functions of a board: bytes out
// Appends all `n` bytes to the transmit buffer, or returns false if the buffer has no room for all
// of them. Never waits. Called from main.
bool board_send(const uint8_t *bytes, uint8_t n);

// Returns the device time at which the first byte of the next `board_send` will leave. Called from
// main.
uint32_t board_send_us(void);

// ------------------------------------------------------------- functions of a board: its state
uint64_t board_uid(void); // identifies this piece of hardware
uint32_t board_boot_id(void); // differs at each boot, not 0; called once, by `rig_begin`
uint32_t board_token(void); // differs at each call, not 0
uint32_t board_firmware_crc(void); // CRC-32 of the firmware's image
uint8_t board_reset_flags(void); // reset flags of the processor, unchanged
uint16_t board_isr_max_us(void); // longest interrupt handler since boot
uint16_t board_stack_free(void); // smallest free stack since boot, in bytes
uint16_t board_rx_lost(void); // bytes lost in reception since the previous call
void board_feed_watchdog(void); // feeds the hardware watchdog; called by `rig_poll`

// ------------------------------------------------------------- functions of a board: interrupts
// board_irq_save turns interrupts off and returns their previous state; board_irq_restore restores
// that state. The compiler must not move a memory access across either call. The core keeps
// interrupts off only while it copies a few words. A board may define both as inline functions in
// `board_constants.h`, and then defines BOARD_IRQ_INLINE.
#ifndef BOARD_IRQ_INLINE
uint8_t board_irq_save(void);
void board_irq_restore(uint8_t before);
#endif

// ------------------------------------------------------------- functions of the core for a board
// Starts the core. Call it once from main, when the clock, the converter, the motor, reception and
// transmission work, and the motor is off.
void rig_begin(void);

// Processes a received byte. Call it from main for each byte, in the order of arrival.
void rig_receive(uint8_t byte);

// Checks the watchdog, and sends the samples and STATUS that are due. Call it from main as often as
// possible. After a sample has ended, call it before the next `rig_receive`, so that the sample
// does not wait for a burst of bytes.
void rig_poll(void);

// Kind of a sample. The board passes the kind in each call that belongs to the sample.
enum {
    RIG_ASKED = 0, // requested by board_convert_now
    RIG_TIMED = 1, // taken by the timer of board_timer_start
    RIG_LATE = 2, // flag for both kinds: the sample could not be triggered at its time
};

// Returns the oversampling m of a sample whose first conversion is triggered now. Call it from
// either context.
uint8_t rig_oversampling(void);

// Reports the result of a conversion, of a sample or of board_convert_channel. The code
// is left-justified to 16 bits. Call it from an interrupt.
void rig_reading(uint8_t channel, uint16_t code);

// Latches u of a sample. Call it from an interrupt when channel 0 is held for its last conversion. A
// board may call it earlier if it applies the duty of board_motor_set only at the hold.
void rig_latch(uint8_t what);

// Ends a sample: rig_latch was called, and all conversions have ended and were reported. t_us is
// the time of the last trigger. Call it from an interrupt.
void rig_converted(uint8_t what, uint32_t t_us);

// Ends a run with k_stop: turns the motor off. Call it from an interrupt when the last input was
// held for its whole Ts.
void rig_end(void);

// Reports the measured supply, in mV. Call it from an interrupt, or directly from
// board_measure_supply.
void rig_supply(uint16_t mv);

#endif
