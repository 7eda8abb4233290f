/* Functions to fill in. As exported they measure nothing, move nothing and receive nothing. */
#include "port.h"

#include <math.h>

ant_sensors read_sensors(void) {
    /* e.g. .theta = counts * (2 * pi / COUNTS_PER_TURN) - zero, .P1 = (volts - 0.5f) / 4 * 10e5f */
    const ant_sensors s = {NAN, NAN, NAN};
    return s;
}

void write_valves(float P1, float P2) {
    (void)P1; /* e.g. dac_write(0, P1 / 6e5f * 4095) of a regulator for 0 to 6 bar */
    (void)P2;
}

uint32_t clock_us(void) { return 0; /* e.g. a 32-bit timer that counts microseconds */ }

int receive_byte(void) { return -1; /* e.g. the next byte of the buffer that the UART's interrupt fills */ }

void send_bytes(const uint8_t *bytes, size_t n) {
    (void)bytes; /* e.g. the UART's DMA, or a buffer that its interrupt empties */
    (void)n;
}
