// SPDX-License-Identifier: GPL-3.0-or-later
// The UART as on silicon, in place of simavr's UART. A byte takes ten bits (simavr: eleven). The
// receiver holds two bytes, and a third byte in its shift register (simavr: 64). Further bytes are
// lost.
#include <avr_uart.h>
#include <sim_cycle_timers.h>
#include "fil.h"

enum { UCSRA = 0xc0, UCSRB = 0xc1, UDR = 0xc6, UBRRL = 0xc4, UBRRH = 0xc5 };
enum { RXC = 0x80, TXC = 0x40, UDRE = 0x20, DOR = 0x08, U2X = 0x02 }; // UCSR0A
enum { RXCIE = 0x80, UDRIE = 0x20, RXEN = 0x10, TXEN = 0x08 }; // UCSR0B

int uart_frame_ended;

static avr_int_vector_t *rxc, *udre, *txc;
static cycles_t line_byte; // time of a byte on the host's line, in cycles

// The line from the host: a ring of bytes, each with the earliest cycle at which it may begin.
static struct {
    uint8_t byte;
    cycles_t not_before;
} line[1 << 14];
static unsigned line_head, line_tail;
static cycles_t line_free;

static uint8_t received[3]; // two in the buffer, one in the shift register
static uint8_t follows_loss[3]; // for each received byte: bytes before it were lost
static unsigned n_received;
static uint8_t is_lost; // bytes were lost since the last received byte
static int shifting, buffered; // the transmitter's byte on the wire and the next byte, or -1

static cycles_t device_byte(avr_t *avr) {
    unsigned ubrr = avr->data[UBRRL] | (avr->data[UBRRH] & 15U) << 8;
    return (cycles_t)(ubrr + 1) * (avr->data[UCSRA] & U2X ? 8 : 16) * FIL_BITS_PER_BYTE;
}

// Set or clear a level-triggered interrupt. As on silicon, the interrupt repeats while the level
// holds.
static void level(avr_t *avr, avr_int_vector_t *vector, uint8_t flag, int holds) {
    if (holds) {
        avr_raise_interrupt(avr, vector);
    } else {
        if (vector->pending)
            avr_clear_interrupt(avr, vector);
        avr->data[UCSRA] &= (uint8_t)~flag;
    }
}

// Set DOR for the byte that is read next.
static void show_lost(avr_t *avr) {
    avr->data[UCSRA] &= (uint8_t)~DOR;
    if (n_received && follows_loss[0])
        avr->data[UCSRA] |= DOR;
}

static cycles_t byte_came(avr_t *avr, cycles_t when, void *param) {
    (void)param;
    uint8_t byte = line[line_tail].byte;
    line_tail = (line_tail + 1) % (sizeof line / sizeof *line);
    line_free = when;
    // If both speeds differ by at most 2 %, the receiver reads the byte. Otherwise it reads
    // nothing.
    cycles_t device = device_byte(avr), off = device > line_byte ? device - line_byte : line_byte - device;
    if (avr->data[UCSRB] & RXEN && off * 50 <= line_byte) {
        if (n_received == sizeof received) {
            tell(TOLD_VIOLATION, when, RX_OVERRUN);
            is_lost = 1;
        } else {
            follows_loss[n_received] = is_lost;
            received[n_received++] = byte;
            is_lost = 0;
            level(avr, rxc, RXC, 1);
            show_lost(avr);
        }
    }
    if (line_tail == line_head)
        return 0;
    cycles_t begins = line[line_tail].not_before > when ? line[line_tail].not_before : when;
    return begins + line_byte;
}

// Schedule the bytes that wait on the line.
void uart_resume(avr_t *avr) {
    if (line_tail == line_head || avr_cycle_timer_status(avr, byte_came, NULL))
        return;
    cycles_t begins = line[line_tail].not_before > line_free ? line[line_tail].not_before : line_free;
    cycles_t ends = begins + line_byte;
    avr_cycle_timer_register(avr, ends > avr->cycle ? ends - avr->cycle : 1, byte_came, NULL);
}

// Append bytes to the line.
void uart_host_sends(avr_t *avr, cycles_t not_before, const uint8_t *data, unsigned n) {
    for (unsigned i = 0; i < n; i++) {
        unsigned next = (line_head + 1) % (sizeof line / sizeof *line);
        if (next == line_tail)
            return; // the line is full, as the host's driver would be
        line[line_head].byte = data[i];
        line[line_head].not_before = not_before;
        line_head = next;
    }
    uart_resume(avr);
}

static uint8_t read_udr(avr_t *avr, avr_io_addr_t addr, void *param) {
    (void)addr, (void)param;
    if (!n_received)
        return 0;
    uint8_t byte = received[0];
    n_received--;
    for (unsigned i = 0; i < n_received; i++) {
        received[i] = received[i + 1];
        follows_loss[i] = follows_loss[i + 1];
    }
    level(avr, rxc, RXC, n_received > 0);
    show_lost(avr);
    return byte;
}

static cycles_t byte_left(avr_t *avr, cycles_t when, void *param) {
    (void)param;
    tell(TOLD_BYTE, when, (uint8_t)shifting);
    uart_frame_ended |= shifting == 0;
    shifting = buffered;
    buffered = -1;
    if (shifting < 0) {
        avr_raise_interrupt(avr, txc);
        return 0;
    }
    level(avr, udre, UDRE, 1);
    return when + device_byte(avr);
}

static void write_udr(avr_t *avr, avr_io_addr_t addr, uint8_t v, void *param) {
    (void)addr, (void)param;
    if (!(avr->data[UCSRB] & TXEN))
        return;
    if (buffered >= 0) {
        tell(TOLD_VIOLATION, avr->cycle, TX_OVERRUN);
    } else if (shifting < 0) {
        shifting = v;
        avr_cycle_timer_register(avr, device_byte(avr), byte_left, NULL);
        level(avr, udre, UDRE, 1);
    } else {
        buffered = v;
        level(avr, udre, UDRE, 0);
    }
}

static void write_ucsra(avr_t *avr, avr_io_addr_t addr, uint8_t v, void *param) {
    (void)param;
    if (v & TXC)
        level(avr, txc, TXC, 0);
    avr->data[addr] = (avr->data[addr] & (uint8_t)~U2X) | (v & U2X);
}

static void write_ucsrb(avr_t *avr, avr_io_addr_t addr, uint8_t v, void *param) {
    (void)param;
    avr->data[addr] = v;
    if (!(v & RXEN)) {
        n_received = is_lost = 0;
        show_lost(avr);
        level(avr, rxc, RXC, 0);
    }
    if (v & RXCIE && n_received)
        level(avr, rxc, RXC, 1);
    if (v & UDRIE && buffered < 0)
        level(avr, udre, UDRE, 1);
}

static void write_ubrr(avr_t *avr, avr_io_addr_t addr, uint8_t v, void *param) {
    (void)param;
    avr->data[addr] = v;
}

// Discard the bytes in transmission and reception, and all bytes on the line.
void uart_reset(avr_t *avr) {
    avr_cycle_timer_cancel(avr, byte_came, NULL);
    avr_cycle_timer_cancel(avr, byte_left, NULL);
    line_head = line_tail = n_received = is_lost = 0;
    line_free = avr->cycle;
    shifting = buffered = -1;
    avr->data[UCSRA] = UDRE;
}

// Replace simavr's handlers.
void uart_attach(avr_t *avr, uint32_t baud) {
    line_byte = (cycles_t)FIL_HZ * FIL_BITS_PER_BYTE / baud;
    avr_uart_t *simavrs = avr->io[AVR_DATA_TO_IO(UDR)].r.param;
    rxc = &simavrs->rxc;
    udre = &simavrs->udrc;
    txc = &simavrs->txc;
    avr->io[AVR_DATA_TO_IO(UDR)].r.c = read_udr;
    avr->io[AVR_DATA_TO_IO(UDR)].w.c = write_udr;
    avr->io[AVR_DATA_TO_IO(UCSRA)].r.c = NULL;
    avr->io[AVR_DATA_TO_IO(UCSRA)].w.c = write_ucsra;
    avr->io[AVR_DATA_TO_IO(UCSRB)].w.c = write_ucsrb;
    avr->io[AVR_DATA_TO_IO(UBRRL)].w.c = write_ubrr;
    uart_reset(avr);
}
