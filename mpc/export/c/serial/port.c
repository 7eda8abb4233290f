/* Functions to fill in. As exported they measure nothing, move nothing and receive nothing. */
#include "port.h"

#include <math.h>

ant_sensors read_sensors(void) {
    ant_sensors s;
    for (int i = 0; i < ANT_JOINTS; i++) s.theta[i] = NAN; /* e.g. counts[i] * (2 * pi / COUNTS_PER_TURN) - zero[i] */
    for (int i = 0; i < ANT_MUSCLES; i++) s.P[i] = NAN;    /* e.g. (volts[i] - 0.5f) / 4 * 10e5f */
    return s;
}

void write_valves(const float P[ANT_MUSCLES]) {
    (void)P; /* e.g. dac_write(i, P[i] / 6e5f * 4095) of regulators for 0 to 6 bar */
}

uint32_t clock_us(void) { return 0; /* e.g. a 32-bit timer that counts microseconds */ }

int receive_byte(void) { return -1; /* e.g. the next byte of the buffer that the UART's interrupt fills */ }

void send_bytes(const uint8_t *bytes, size_t n) {
    (void)bytes; /* e.g. the UART's DMA, or a buffer that its interrupt empties */
    (void)n;
}
