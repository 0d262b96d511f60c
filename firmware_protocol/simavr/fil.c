// SPDX-License-Identifier: GPL-3.0-or-later
// The firmware in the loop: an Uno in simavr. The host controls its time over a pipe (README.md).
#include <getopt.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <avr_eeprom.h>
#include <avr_uart.h>
#include <sim_cycle_timers.h>
#include <sim_hex.h>
#include "fil.h"

enum { MCUSR = 0x54, EXTRF = 2 };

fil_figures_t figures;

static avr_t *avr;
static uint8_t r2_of_loader; // the value that the boot loader leaves in r2
static cycles_t deaf_until; // the boot loader runs until this cycle
static cycles_t off_since; // cycle at which interrupts were turned off
static uint32_t off_pc;
static int were_on;

static void sleep_without_waiting(avr_t *a, cycles_t n) {
    (void)a;
    figures.idle += n;
}

static cycles_t reached(avr_t *a, cycles_t when, void *param) {
    (void)a, (void)when, (void)param;
    return 0;
}

// Called at each reset of the processor, also at a reset by the watchdog.
static void after_reset(avr_t *a) {
    figures.boots++;
    were_on = 0;
    uart_reset(a);
    pwm_reset(a);
}

// Reset by the pin, as a reset button or DTR does. With a boot loader, the program receives nothing
// for `deaf_cycles`.
static void reset_by_pin(uint32_t deaf_cycles) {
    avr_reset(avr);
    avr->data[MCUSR] = deaf_cycles ? 0 : EXTRF; // the boot loader clears it
    avr->data[2] = r2_of_loader;
    deaf_until = avr->cycle + deaf_cycles;
}

static void watch_interrupts(void) {
    int on = avr->sreg[S_I];
    if (on) {
        if (were_on < 0 && avr->cycle - off_since > figures.interrupts_off_max) {
            figures.interrupts_off_max = avr->cycle - off_since;
            figures.interrupts_off_pc = off_pc;
        }
        were_on = 1;
    } else if (were_on > 0) {
        were_on = -1; // off now, and on before in this boot
        off_since = avr->cycle;
        off_pc = avr->pc;
    }
}

// Run until a cycle, or until the end of a frame to the host.
static void advance(cycles_t target, int until_frame) {
    if (avr->cycle < deaf_until) {
        cycles_t to = target < deaf_until ? target : deaf_until;
        avr->cycle = to;
        if (to < deaf_until)
            return;
        uart_reset(avr);
        pwm_reset(avr);
    }
    uart_resume(avr);
    uart_frame_ended = 0;
    while (avr->cycle < target && !(until_frame && uart_frame_ended)) {
        // This timer wakes simavr at the target while the processor sleeps.
        if (!avr_cycle_timer_status(avr, reached, NULL))
            avr_cycle_timer_register(avr, target - avr->cycle, reached, NULL);
        int state = avr_run(avr);
        watch_interrupts();
        if (state == cpu_Done || state == cpu_Crashed) {
            tell(TOLD_VIOLATION, avr->cycle, CPU_STOPPED);
            avr->cycle = target;
        }
    }
    avr_cycle_timer_cancel(avr, reached, NULL);
}

static void eeprom(int write, uint16_t offset, uint16_t n, uint8_t *data) {
    avr_eeprom_desc_t what = {.ee = data, .offset = offset, .size = n};
    avr_ioctl(avr, write ? AVR_IOCTL_EEPROM_SET : AVR_IOCTL_EEPROM_GET, &what);
}

// Execute the host's orders until the pipe ends.
static void serve(void) {
    struct __attribute__((packed)) {
        uint8_t order;
        uint64_t cycle;
        uint32_t n;
    } order;
    static uint8_t data[1 << 16];
    while (hear(&order, sizeof order)) {
        switch (order.order) {
        case 'A': // advance to a cycle; with n = 1 at most to the end of a frame
            advance(order.cycle, (int)order.n);
            tell(TOLD_DONE, avr->cycle, 0);
            flush_told();
            break;
        case 'I': // put n bytes on the line, not before a cycle
            if (order.n > sizeof data || !hear(data, order.n))
                return;
            uart_host_sends(avr, order.cycle, data, order.n);
            break;
        case 'R': // reset by the pin; the boot loader runs for n cycles
            reset_by_pin(order.n);
            break;
        case 'O': // Optiboot of version n is in flash, and leaves `cycle` in r2
            memcpy(avr->flash + avr->flashend - 1, &order.n, 2);
            r2_of_loader = (uint8_t)order.cycle;
            break;
        case 'V': // set the supply to n mV
            adc_supply(avr, (uint16_t)order.n);
            break;
        case 'S': // n = 1: stop the converter; n = 0: let it continue
            adc_stand((int)order.n);
            break;
        case 'B': // set the write time of a byte of EEPROM to n us
            eeprom_byte(order.n);
            break;
        case 'W': // write n bytes of EEPROM, from `cycle` on
            if (order.n > sizeof data || !hear(data, order.n))
                return;
            eeprom(1, (uint16_t)order.cycle, (uint16_t)order.n, data);
            break;
        case 'E': // read n bytes of EEPROM, from `cycle` on
            eeprom(0, (uint16_t)order.cycle, (uint16_t)order.n, data);
            tell_data(data, order.n);
            flush_told();
            break;
        case 'F': // send the figures
            tell_data(&figures, sizeof figures);
            flush_told();
            break;
        default:
            return;
        }
    }
}

static void start_trace(const char *path) {
    static avr_vcd_t vcd;
    avr_vcd_init(avr, path, &vcd, 1000);
    pwm_trace(&vcd);
    avr_vcd_start(&vcd);
    avr->vcd = &vcd;
}

static int load(const char *path) {
    uint32_t size = 0, start = 0;
    uint8_t *image = read_ihex_file(path, &size, &start);
    if (!image || start + size > avr->flashend + 1) {
        fprintf(stderr, "fil: %s: no Intel HEX file of an ATmega328P's program\n", path);
        return 0;
    }
    memcpy(avr->flash + start, image, size);
    avr->codeend = avr->flashend;
    free(image);
    return 1;
}

int main(int argc, char **argv) {
    static const struct option options[] = {{"baud", 1, 0, 'b'}, {"vcd", 1, 0, 'v'}, {"pwm", 1, 0, 'p'}, {0, 0, 0, 0}};
    uint32_t baud = 500000;
    const char *trace = NULL, *pin = "D9";
    for (int c; (c = getopt_long(argc, argv, "", options, NULL)) != -1;) {
        if (c == 'b')
            baud = (uint32_t)strtoul(optarg, NULL, 10);
        else if (c == 'v')
            trace = optarg;
        else if (c == 'p')
            pin = optarg;
        else
            return 2;
    }
    if (optind != argc - 1 || !baud) {
        fprintf(stderr, "usage: fil [--baud BAUD] [--pwm D9|D3] [--vcd FILE] FIRMWARE.hex\n");
        return 2;
    }
    avr = avr_make_mcu_by_name("atmega328p");
    if (!avr)
        return 1;
    avr_init(avr);
    avr->frequency = FIL_HZ;
    avr->log = LOG_NONE;
    avr->sleep = sleep_without_waiting;
    if (!load(argv[optind]))
        return 1;
    uart_attach(avr, baud);
    if (!pwm_attach(avr, pin)) {
        fprintf(stderr, "fil: --pwm %s: D9 or D3\n", pin);
        return 2;
    }
    adc_attach(avr);
    eeprom_attach(avr);
    flags_attach(avr);
    avr->reset = after_reset;
    figures.boots = 1;
    if (trace)
        start_trace(trace);
    serve();
    if (avr->vcd)
        avr_vcd_close(avr->vcd);
    return 0;
}
