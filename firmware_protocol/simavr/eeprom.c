// SPDX-License-Identifier: GPL-3.0-or-later
// The write time of a byte of EEPROM. simavr 1.6 writes a byte without delay.
#include <avr_eeprom.h>
#include <sim_cycle_timers.h>
#include "fil.h"

enum { EECR = 0x3f, EEPE = 0x02, EEMPE = 0x04, DATA_SHEET_US = 3400 }; // table 8-1: erase and write

static avr_io_write_t of_simavr;
static void *param_of_simavr;
static uint32_t byte_us = DATA_SHEET_US;

static cycles_t is_written(avr_t *avr, cycles_t when, void *param) {
    (void)when, (void)param;
    avr->data[EECR] &= (uint8_t)~EEPE;
    return 0;
}

static void write_eecr(avr_t *avr, avr_io_addr_t addr, uint8_t v, void *param) {
    (void)param;
    int is_busy = avr->data[EECR] & EEPE, writes = v & EEPE && avr->data[EECR] & EEMPE;
    if (is_busy)
        return; // during a write the EEPROM is neither read nor written
    of_simavr(avr, addr, v, param_of_simavr);
    if (writes) {
        avr->data[EECR] |= EEPE;
        avr_cycle_timer_register_usec(avr, byte_us, is_written, NULL);
    }
}

// Set the write time of a byte.
void eeprom_byte(uint32_t us) {
    byte_us = us;
}

// Put this handler in front of simavr's handler.
void eeprom_attach(avr_t *avr) {
    of_simavr = avr->io[AVR_DATA_TO_IO(EECR)].w.c;
    param_of_simavr = avr->io[AVR_DATA_TO_IO(EECR)].w.param;
    avr->io[AVR_DATA_TO_IO(EECR)].w.c = write_eecr;
}
