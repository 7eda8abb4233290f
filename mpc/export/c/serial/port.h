/* The five functions of a board; port.c has empty ones to fill in. All are called from ant_board_poll, one after the
 * other; none may wait. */
#ifndef ANT_PORT_H
#define ANT_PORT_H

#include <stddef.h>
#include <stdint.h>

#include "config.h"

/* Sensor readings; NAN if missing or unreliable. */
typedef struct {
    float theta[ANT_JOINTS]; /* joint angles [rad] */
    float P[ANT_MUSCLES];    /* gauge pressures [Pa]; of a joint those of agonist and antagonist */
} ant_sensors;

ant_sensors read_sensors(void);

/* Set all regulators [Pa], within the supply's limits in config.h. */
void write_valves(const float P[ANT_MUSCLES]);

/* A clock that never stops and wraps after 2^32 [us]. */
uint32_t clock_us(void);

/* The next byte that has arrived, 0 to 255, or -1: from a buffer that an interrupt fills, 512 bytes or more. */
int receive_byte(void);

/* Send these bytes, or queue them for an interrupt that sends them. */
void send_bytes(const uint8_t *bytes, size_t n);

#endif /* ANT_PORT_H */
