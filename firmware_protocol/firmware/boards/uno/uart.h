// The serial line: a ring each way, filled and emptied by interrupts.
#ifndef UART_H
#define UART_H

#include <stdint.h>

void uart_begin(void);

// Returns the next byte that came, or -1.
int16_t uart_next(void);

#endif
