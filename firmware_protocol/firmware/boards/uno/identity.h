// The identity of this board and this boot, from the EEPROM and from noise.
#ifndef IDENTITY_H
#define IDENTITY_H

// Called at boot, with the converter on.
void identity_begin(void);

#endif
