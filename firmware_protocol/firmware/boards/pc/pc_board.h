// The board on a PC. Its user sets the time, and connects the hardware as functions.
#ifndef PC_BOARD_H
#define PC_BOARD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

// The functions that the core requires of a board, as in board.h.
struct pc_hardware {
    void (*motor_off)(void);
    void (*motor_set)(uint16_t duty);
    void (*convert_now)(void);
    void (*timer_start)(uint32_t t0_us, uint32_t ts_us, uint32_t k_stop);
    void (*timer_stop)(void);
    bool (*converter_is_free)(void);
    void (*convert_channel)(uint8_t channel, uint16_t n);
    void (*measure_supply)(void);
    bool (*send)(const uint8_t *bytes, uint8_t n);
    uint32_t (*send_us)(void);
    uint32_t (*token)(void);
};

// Connects the hardware.
void pc_plug(const struct pc_hardware *hardware);

// Resets the processor: sets the boot_id and the reset flags of the next boot.
void pc_reset(uint32_t boot_id, uint8_t reset_flags);

// The state of the board. Tests exchange it if there are several devices.
extern struct pc_board {
    uint32_t now_us, boot_id;
    uint16_t lost;
    uint8_t reset_flags;
} pc_board;

// Sets the device's clock.
void pc_set_time(uint32_t now_us);

// Adds to the number of received bytes that were lost.
void pc_lose(uint16_t bytes);

#endif
