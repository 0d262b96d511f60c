// What a CRC-32 costs an AVR, in cycles: by the core's table of 256 entries, and by one of 16.
// Build: avr-gcc -mmcu=atmega328p -std=gnu11 -Os -Ifirmware_protocol/firmware/core -o /tmp/crc.elf
//   tests/benchmarks/crc_cycles.c firmware_protocol/firmware/core/rig_crc.c
// Run: simavr -m atmega328p -f 16000000 /tmp/crc.elf
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <stdio.h>

#include "rig_crc.h" // rig_crc
#include "rig_flash.h" // RIG_FLASH

static const RIG_FLASH uint32_t OF_NIBBLE[16] = {
    0x00000000, 0x1DB71064, 0x3B6E20C8, 0x26D930AC, 0x76DC4190, 0x6B6B51F4, 0x4DB26158, 0x5005713C,
    0xEDB88320, 0xF00F9344, 0xD6D6A3E8, 0xCB61B38C, 0x9B64C2B0, 0x86D3D2D4, 0xA00AE278, 0xBDBDF21C,
};

// The other way: two shifts by four a byte.
static __attribute__((noinline)) uint32_t by_nibbles(const uint8_t *bytes, uint8_t n)
{
    uint32_t crc = 0xFFFFFFFF;
    for (; n; n--, bytes++) {
        crc ^= *bytes;
        crc = crc >> 4 ^ OF_NIBBLE[crc & 15];
        crc = crc >> 4 ^ OF_NIBBLE[crc & 15];
    }
    return ~crc;
}

// Prints by the UART, which simavr shows.
static int put(char c, FILE *stream)
{
    (void)stream;
    while (!(UCSR0A & _BV(UDRE0)))
        ;
    UDR0 = c;
    return 0;
}

int main(void)
{
    static FILE out = FDEV_SETUP_STREAM(put, NULL, _FDEV_SETUP_WRITE);
    static uint8_t bytes[58];
    static const uint8_t LENGTHS[] = {30, 58}; // of a SAMPLE and of a SETPOINTS
    for (uint8_t i = 0; i < sizeof bytes; i++)
        bytes[i] = i * 37;
    stdout = &out;
    UCSR0B = _BV(TXEN0);
    TCCR1B = _BV(CS10);
    for (uint8_t i = 0; i < sizeof LENGTHS; i++) {
        const uint8_t n = LENGTHS[i];
        const uint16_t t0 = TCNT1;
        const uint32_t one = rig_crc(bytes, n);
        const uint16_t t1 = TCNT1;
        const uint32_t other = by_nibbles(bytes, n);
        const uint16_t t2 = TCNT1;
        printf("%u bytes: %u cycles by 256 entries, %u by 16%s\n", n, t1 - t0 - 2, t2 - t1 - 2,
            one == other ? "" : "; they differ");
    }
    cli();
    sleep_enable();
    sleep_cpu();
}
