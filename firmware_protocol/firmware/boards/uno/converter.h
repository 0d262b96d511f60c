// The converter (ADC): samples triggered by timer 0, and single readings between samples.
#ifndef CONVERTER_H
#define CONVERTER_H

#include <stdbool.h>
#include <stdint.h>

void converter_begin(void);

// Converts one channel, and waits for the reading. Called at boot.
uint16_t converter_read(uint8_t channel);

// While no sample is scheduled, advances the supply measurement. Called from main, once a turn of
// the clock or less often.
void converter_turn(void);

// Returns true if a sample was taken or a run has ended since the last call. Called from main.
bool converter_has_news(void);

// Returns false if a sample is overdue by 50 ms, or if a handler was too late for a conversion.
bool converter_is_alive(void);

// Set the multiplexer to a channel; convert that channel. For readings that belong to no sample.
void converter_turn_to(uint8_t channel);
void converter_convert(void);

#endif
