// What tells this board and this boot from others: from the EEPROM, and from noise.
#ifndef IDENTITY_H
#define IDENTITY_H

// At boot, with the converter on.
void identity_begin(void);

#endif
