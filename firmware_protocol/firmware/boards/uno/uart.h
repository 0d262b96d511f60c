// The serial line: one ring buffer for each direction. Interrupts fill and empty the rings.
#ifndef UART_H
#define UART_H

#include <stdint.h>

void uart_begin(void);

// Returns the next received byte, or -1 if there is none.
int16_t uart_next(void);

// Pause and continue the transmission. After the pause, up to two more bytes leave. An interrupt
// handler calls both functions with interrupts off, and may enable interrupts between the calls.
void uart_pause(void);
void uart_go_on(void);

#endif
