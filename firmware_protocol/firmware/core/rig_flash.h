// Where constant tables lie: an AVR would copy them to RAM.
#ifndef RIG_FLASH_H
#define RIG_FLASH_H

#ifdef __AVR__
#define RIG_FLASH __flash
#else
#define RIG_FLASH
#endif

#endif
