#include "pc_board.h"

#include "../../core/board.h"

struct pc_board pc_board;
static struct pc_hardware hardware;

void pc_plug(const struct pc_hardware *plugged)
{
    hardware = *plugged;
}

void pc_reset(uint32_t boot_id, uint8_t reset_flags)
{
    pc_board.boot_id = boot_id;
    pc_board.reset_flags = reset_flags;
    pc_board.lost = 0;
}

void pc_set_time(uint32_t now_us)
{
    pc_board.now_us = now_us;
}

void pc_lose(uint16_t bytes)
{
    pc_board.lost += bytes;
}

void board_motor_off(void) { hardware.motor_off(); }
void board_motor_set(uint16_t duty) { hardware.motor_set(duty); }
uint32_t board_now_us(void) { return pc_board.now_us; }
void board_convert_now(void) { hardware.convert_now(); }

void board_timer_start(uint32_t t0_us, uint32_t ts_us, uint32_t k_stop)
{
    hardware.timer_start(t0_us, ts_us, k_stop);
}

void board_timer_stop(void) { hardware.timer_stop(); }
bool board_converter_is_free(void) { return hardware.converter_is_free(); }
void board_convert_channel(uint8_t channel, uint16_t n) { hardware.convert_channel(channel, n); }
void board_measure_supply(void) { hardware.measure_supply(); }
bool board_send(const uint8_t *bytes, uint8_t n) { return hardware.send(bytes, n); }
uint32_t board_send_us(void) { return hardware.send_us(); }
uint64_t board_uid(void) { return 0x726F74616C756D65; } // "emulator"
uint32_t board_boot_id(void) { return pc_board.boot_id; }
uint32_t board_token(void) { return hardware.token(); }
uint32_t board_firmware_crc(void) { return 0; }
uint8_t board_reset_flags(void) { return pc_board.reset_flags; }
uint16_t board_isr_max_us(void) { return 0; }
uint16_t board_stack_free(void) { return UINT16_MAX; }

uint16_t board_rx_lost(void)
{
    const uint16_t lost = pc_board.lost;
    pc_board.lost = 0;
    return lost;
}

void board_feed_watchdog(void) {}
