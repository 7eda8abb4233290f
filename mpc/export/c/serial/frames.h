/* Frames on a serial line: 0x00, COBS(payload, CRC-32), 0x00; docs/serial.md of `antagonist` explains them. */
#ifndef ANT_FRAMES_H
#define ANT_FRAMES_H

#include <stddef.h>
#include <stdint.h>

#include "protocol.h"

enum { ANT_LINE_BYTES = ANT_LONGEST + 3 }; /* of a frame on the line at most */

/* Bytes received since the last zero. */
typedef struct {
    uint8_t bytes[ANT_LONGEST + 1];
    size_t n;
    int lost;         /* longer than any frame */
    uint16_t damaged; /* byte sequences that were no frame */
} ant_receiver;

/* Take a byte; the length of the payload that it ends, less the CRC, which is then in r->bytes; 0 if it ends none. */
size_t ant_receive(ant_receiver *r, uint8_t byte);

/* Write the frame of the payload, at most ANT_LONGEST - ANT_CRC_BYTES of it, to `line`; its length. */
size_t ant_frame(const uint8_t *payload, size_t n, uint8_t line[ANT_LINE_BYTES]);

/* Numbers in a payload, little endian on every machine. A float is an IEEE 754 binary32. */
uint16_t ant_get_u16(const uint8_t *at);
uint32_t ant_get_u32(const uint8_t *at);
float ant_get_f32(const uint8_t *at);
void ant_put_u16(uint8_t *at, uint16_t value);
void ant_put_u32(uint8_t *at, uint32_t value);
void ant_put_f32(uint8_t *at, float value);
void ant_put_row(uint8_t *at, const float *values, int count);
void ant_get_row(const uint8_t *at, float *values, int count);

#endif /* ANT_FRAMES_H */
