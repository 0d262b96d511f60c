// SPDX-License-Identifier: GPL-3.0-or-later
// The pipe to the host: stdin and stdout, fixed-size little-endian records.
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include "fil.h"

typedef struct __attribute__((packed)) {
    uint8_t kind;
    uint64_t cycle;
    uint32_t value;
} told_t;

static uint8_t buffer[1 << 16];
static unsigned used;

// Write all buffered bytes. If the host has closed the pipe, end this process.
void flush_told(void) {
    unsigned done = 0;
    while (done < used) {
        ssize_t n = write(STDOUT_FILENO, buffer + done, used - done);
        if (n <= 0)
            exit(0);
        done += (unsigned)n;
    }
    used = 0;
}

static void put(const void *data, unsigned n) {
    if (used + n > sizeof buffer)
        flush_told();
    memcpy(buffer + used, data, n);
    used += n;
}

// Buffer a record of an event for the host.
void tell(uint8_t kind, cycles_t cycle, uint32_t value) {
    told_t told = {kind, cycle, value};
    put(&told, sizeof told);
}

// Buffer a record with the number n, and then n bytes.
void tell_data(const void *data, uint32_t n) {
    tell(TOLD_DATA, 0, n);
    put(data, n);
}

// Read exactly n bytes. Return 0 if the host has closed the pipe.
int hear(void *data, unsigned n) {
    uint8_t *to = data;
    while (n) {
        ssize_t got = read(STDIN_FILENO, to, n);
        if (got <= 0)
            return 0;
        to += got;
        n -= (unsigned)got;
    }
    return 1;
}

// Request the reading at the converter's hold from the host, and return its ten bits.
uint16_t ask_conversion(cycles_t cycle, uint8_t channel) {
    uint16_t code;
    tell(TOLD_CONVERSION, cycle, channel);
    flush_told();
    if (!hear(&code, sizeof code))
        exit(0);
    return code;
}
