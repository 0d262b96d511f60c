// RIG_FLASH places a constant table in flash. Without RIG_FLASH, an AVR would copy the table to
// RAM.
#ifndef RIG_FLASH_H
#define RIG_FLASH_H

#ifdef __AVR__
#define RIG_FLASH __flash
#else
#define RIG_FLASH
#endif

#endif
