// The converter: samples, triggered by timer 0, and single readings between them.
#ifndef CONVERTER_H
#define CONVERTER_H

#include <stdbool.h>
#include <stdint.h>

void converter_begin(void);

// Converts one channel and waits for it. At boot.
uint16_t converter_read(uint8_t channel);

// Once a turn of the clock, or less often. From main.
void converter_turn(void);

// Returns whether a sample was taken, or a run has ended, since it was last asked. From main.
bool converter_has_news(void);

// False where a sample has been due for too long: no interrupt has come.
bool converter_is_alive(void);

// Turns the multiplexer, converts what it is turned to: for readings that are no sample's.
void converter_turn_to(uint8_t channel);
void converter_convert(void);

#endif
