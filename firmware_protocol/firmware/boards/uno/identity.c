// An ATmega328P has no random source, and its data sheet documents no serial number. The identity
// therefore uses the EEPROM and the noise of the converter.
//
// The EEPROM contains the count of the boots in a ring of 64 places. Each place is written at every
// 64th boot, so that its 100 000 writes last for 6.4 million boots. A place contains a count and
// its check. If a power failure interrupts a write, the check of this place fails, and the next
// boot repeats the count. The interrupted boot has not reported its count to anybody.
//
// The low half of boot_id is a permutation of the low half of the count. The low half is in every
// SAMPLE, and differs among 65536 successive boots. The high half is mixed with noise. The uid is
// drawn from noise once, and stored.
#include "identity.h"

#include <avr/eeprom.h>
#include <avr/wdt.h>
#include <stddef.h>

#include "board.h"
#include "converter.h"
#include "pins.h"
#include "rig_crc.h"

struct count {
    uint32_t boots;
    uint32_t check; // of boots
};

struct uid {
    uint64_t number;
    uint32_t check;
};

enum { PLACES = 64, NOISY_READINGS = 32 };

static struct count EEMEM counts[PLACES];
static struct uid EEMEM uids[2]; // the second is used if a power failure has spoilt the first
static uint32_t boots, noise;
static uint64_t uid;

// Returns the complement of the CRC. In an erased EEPROM all bytes are FF, and the CRC of FF FF FF
// FF is FF FF FF FF: the CRC itself would match.
static uint32_t check_of(const void *bytes, uint8_t n)
{
    return ~rig_crc(bytes, n);
}

// Mixes `more` into a state of 32 bits (the finaliser of MurmurHash3, a bijection of the state).
static uint32_t mixed(uint32_t state, uint32_t more)
{
    state ^= more;
    state = (state ^ state >> 16) * 0x85EBCA6BUL;
    state = (state ^ state >> 13) * 0xC2B2AE35UL;
    return state ^ state >> 16;
}

// Collects noise from the lowest bits of an open pin and of the potentiometers.
static void gather_noise(void)
{
    static const uint8_t channels[] = {OPEN_CHANNEL, THETA_1_CHANNEL, ALPHA_CHANNEL, OPEN_CHANNEL};
    for (uint8_t i = 0; i < NOISY_READINGS; i++)
        noise = mixed(noise, (uint32_t)converter_read(channels[i % sizeof channels]) << 8 | TCNT1L);
}

// Writes the bytes that differ. A byte takes 3.4 ms (data sheet, table 8-1), and a first boot
// writes 32 bytes. The hardware watchdog is fed after each byte, and resets the processor if a
// write does not end.
static void keep(void *to, const void *from, uint8_t n)
{
    uint8_t *at = to;
    const uint8_t *byte = from;
    while (n--) {
        eeprom_update_byte(at++, *byte++);
        wdt_reset();
    }
}

// Finds the newest count, and writes the next count into the next place. Returns false if the write
// failed.
static bool count_boot(void)
{
    struct count count = {0};
    uint8_t place = 0;
    boots = 0;
    for (uint8_t i = 0; i < PLACES; i++) {
        eeprom_read_block(&count, &counts[i], sizeof count);
        if (count.check == check_of(&count.boots, sizeof count.boots) && count.boots > boots) {
            boots = count.boots;
            place = (i + 1) % PLACES;
        }
    }
    boots++;
    const struct count next = {boots, check_of(&boots, sizeof boots)};
    keep(&counts[place], &next, sizeof next);
    eeprom_read_block(&count, &counts[place], sizeof count);
    return count.boots == boots && count.check == next.check;
}

static bool read_uid(uint8_t place)
{
    struct uid found;
    eeprom_read_block(&found, &uids[place], sizeof found);
    uid = found.number;
    return uid != 0 && found.check == check_of(&found.number, sizeof found.number);
}

static void draw_uid(void)
{
    uid = (uint64_t)mixed(noise, 1) << 32 | mixed(noise, 2) | 1;
    const struct uid drawn = {uid, check_of(&uid, sizeof uid)};
    keep(&uids[1], &drawn, sizeof drawn);
    keep(&uids[0], &drawn, sizeof drawn);
}

void identity_begin(void)
{
    gather_noise();
    if (!read_uid(0) && !read_uid(1))
        draw_uid();
    if (!count_boot())
        boots = noise; // the EEPROM is worn out
}

uint64_t board_uid(void)
{
    return uid;
}

uint32_t board_boot_id(void)
{
    const uint16_t low = boots * 0x9E37U + (uint16_t)uid; // the factor is odd: a permutation
    const uint32_t high = mixed(noise ^ (uint32_t)uid, boots);
    const uint32_t boot_id = (high & 0xFFFF0000UL) | low;
    return boot_id ? boot_id : 1;
}

uint32_t board_token(void)
{
    do
        noise = mixed(noise, board_now_us()) + 1;
    while (!noise);
    return noise;
}
