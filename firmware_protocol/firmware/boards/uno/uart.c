#include "uart.h"

#include "board.h"

#ifndef BAUD
#define BAUD 500000
#endif
_Static_assert(F_CPU % (8L * BAUD) == 0, "this speed cannot be had exactly");

enum {
    RX_RING = 128, // more bytes than arrive while main builds a SAMPLE; a power of two
    TX_RING = 256, // seven SAMPLEs; an 8-bit index wraps at 256
    BYTE_US = 10000000L / BAUD,
};

static volatile uint8_t rx[RX_RING], rx_head, rx_tail; // the interrupt writes rx_head, main rx_tail
static volatile uint8_t rx_lost;
static volatile uint8_t tx[TX_RING], tx_head, tx_tail; // main writes tx_head, the interrupt tx_tail
static uint32_t tx_free_us; // device time at which the last byte to be sent has left

// Kept as short as possible, because at 1 Mbaud a byte arrives every 10 us. The CRC detects a
// framing error. If the ring is full, the handler disables its interrupt until main has emptied the
// ring. A flooded line must not keep main from guarding the motor.
ISR(USART_RX_vect)
{
    const uint8_t status = UCSR0A, head = rx_head, next = (uint8_t)(head + 1) & (RX_RING - 1);
    rx[head] = UDR0;
    if (next != rx_tail) {
        rx_head = next;
    } else {
        rx_lost++;
        UCSR0B &= (uint8_t)~_BV(RXCIE0);
    }
    if (status & _BV(DOR0)) // data sheet: bytes were lost between this byte and the previous byte
        rx_lost++;
}

ISR(USART_UDRE_vect)
{
    uint8_t tail = tx_tail;
    UDR0 = tx[tail++];
    tx_tail = tail;
    if (tail == tx_head)
        UCSR0B &= (uint8_t)~_BV(UDRIE0);
}

static uint8_t paused;

void uart_pause(void)
{
    paused = UCSR0B & _BV(UDRIE0);
    UCSR0B &= (uint8_t)~_BV(UDRIE0);
}

void uart_go_on(void)
{
    UCSR0B |= paused;
}

void uart_begin(void)
{
    UCSR0A = _BV(U2X0); // before UBRR0: at its write, some models compute the speed
    UBRR0 = F_CPU / 8 / BAUD - 1;
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00); // 8N1
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
}

// Sets bits of UCSR0B. Interrupts clear other bits of this register.
static void enable(uint8_t bits)
{
    const uint8_t before = board_irq_save();
    UCSR0B |= bits;
    board_irq_restore(before);
}

int16_t uart_next(void)
{
    if (rx_tail == rx_head) {
        if (!(UCSR0B & _BV(RXCIE0)))
            enable(_BV(RXCIE0));
        return -1;
    }
    const uint8_t byte = rx[rx_tail];
    rx_tail = (uint8_t)(rx_tail + 1) & (RX_RING - 1);
    return byte;
}

bool board_send(const uint8_t *bytes, uint8_t n)
{
    const uint8_t used = tx_head - tx_tail;
    if (n >= TX_RING - used)
        return false;
    tx_free_us = board_send_us() + n * (uint32_t)BYTE_US;
    uint8_t head = tx_head;
    while (n--)
        tx[head++] = *bytes++;
    tx_head = head;
    enable(_BV(UDRIE0));
    return true;
}

uint32_t board_send_us(void)
{
    const uint32_t now_us = board_now_us();
    return (int32_t)(tx_free_us - now_us) > 0 ? tx_free_us : now_us;
}

uint16_t board_rx_lost(void)
{
    const uint8_t before = board_irq_save();
    const uint8_t lost = rx_lost;
    rx_lost = 0;
    board_irq_restore(before);
    return lost;
}
