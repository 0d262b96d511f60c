// The serial line: a ring each way, filled and emptied by interrupts.
#ifndef UART_H
#define UART_H

#include <stdint.h>

void uart_begin(void);

// Returns the next byte that came, or -1.
int16_t uart_next(void);

// Lets what is to be sent wait, and go on: two bytes are on their way meanwhile. From an interrupt,
// with interrupts off, whatever comes between.
void uart_pause(void);
void uart_go_on(void);

#endif
