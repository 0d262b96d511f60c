// SPDX-License-Identifier: GPL-3.0-or-later
// Declarations that all parts of the harness share: one ATmega328P, and the pipe to the host.
#ifndef FIL_H
#define FIL_H

#include <stddef.h>
#include <stdint.h>
#include <sim_avr.h>
#include <sim_vcd_file.h>

typedef avr_cycle_count_t cycles_t; // cycles of 62.5 ns since the processor was first switched on

#define FIL_HZ 16000000U
#define FIL_BITS_PER_BYTE 10U // 8N1

// Records from the harness to the host. README.md describes their fields.
enum { TOLD_CONVERSION = 'a', TOLD_VOLTS = 'v', TOLD_BYTE = 't', TOLD_VIOLATION = 'x', TOLD_DONE = 'd', TOLD_DATA = 'e' };

// Violations. The host counts each violation as a failure.
enum {
    PIN_HIGH_WITHOUT_ENABLE = 1, // the PWM pin is high while the driver's enable line is low
    RX_OVERRUN = 2, // the receiver lost a byte: its buffer and its shift register were full
    TX_OVERRUN = 3, // the firmware wrote into a full transmit buffer
    CPU_STOPPED = 4, // the processor left its code, or sleeps with interrupts off
};

// Figures since the start of the harness, as sent to the host.
typedef struct __attribute__((packed)) {
    uint64_t last_high; // cycle at which the PWM pin was last high
    uint64_t interrupts_off_max; // longest time with interrupts off, in cycles
    uint64_t interrupts_off_pc; // address of the program at which this time began
    uint64_t idle; // cycles during which the processor slept
    uint64_t boots; // number of boots, the first included
    uint64_t edges; // number of edges of the PWM pin
} fil_figures_t;

extern fil_figures_t figures;

// pipe.c: the harness buffers its records until the host must answer or may continue.
void tell(uint8_t kind, cycles_t cycle, uint32_t value);
void tell_data(const void *data, uint32_t n);
uint16_t ask_conversion(cycles_t cycle, uint8_t channel);
void flush_told(void);
int hear(void *data, unsigned n); // 0 at end of file

// uart.c
void uart_attach(avr_t *avr, uint32_t baud);
void uart_reset(avr_t *avr); // discards all bytes in both directions
void uart_resume(avr_t *avr); // the line continues once the processor runs
void uart_host_sends(avr_t *avr, cycles_t not_before, const uint8_t *data, unsigned n);
extern int uart_frame_ended; // the byte 00 has left since this flag was cleared

// pwm.c
int pwm_attach(avr_t *avr, const char *pin_name); // 0 for an unknown pin
void pwm_trace(avr_vcd_t *vcd);
void pwm_reset(avr_t *avr);

// adc.c
void adc_attach(avr_t *avr);
void adc_supply(avr_t *avr, uint16_t millivolts);
void adc_stand(int is_to);

// eeprom.c
void eeprom_attach(avr_t *avr);
void eeprom_byte(uint32_t us);

// flags.c: corrects the interrupt flags of timer 0 in simavr 1.6
void flags_attach(avr_t *avr);
avr_int_vector_t *vector_of(avr_t *avr, uint8_t number);

#endif
