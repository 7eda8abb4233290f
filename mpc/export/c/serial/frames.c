/* Frames: consistent overhead byte stuffing (Cheshire and Baker 1999) and the CRC-32 of IEEE 802.3. */
#include "frames.h"

#include <string.h>

/* a float of another size could not be transmitted */
typedef char ant_float_is_binary32[sizeof(float) == 4 ? 1 : -1];

uint16_t ant_get_u16(const uint8_t *at) { return (uint16_t)(at[0] | (uint16_t)(at[1] << 8)); }

uint32_t ant_get_u32(const uint8_t *at) { return ant_get_u16(at) | (uint32_t)ant_get_u16(at + 2) << 16; }

float ant_get_f32(const uint8_t *at) {
    const uint32_t bits = ant_get_u32(at);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

void ant_put_u16(uint8_t *at, uint16_t value) {
    at[0] = (uint8_t)(value & 0xFF);
    at[1] = (uint8_t)(value >> 8);
}

void ant_put_u32(uint8_t *at, uint32_t value) {
    ant_put_u16(at, (uint16_t)(value & 0xFFFF));
    ant_put_u16(at + 2, (uint16_t)(value >> 16));
}

void ant_put_f32(uint8_t *at, float value) {
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    ant_put_u32(at, bits);
}

void ant_put_row(uint8_t *at, const float *values, int count) {
    for (int i = 0; i < count; i++) ant_put_f32(at + 4 * i, values[i]);
}

void ant_get_row(const uint8_t *at, float *values, int count) {
    for (int i = 0; i < count; i++) values[i] = ant_get_f32(at + 4 * i);
}

/* Four bits at a time: sixteen numbers in place of a kilobyte of them. */
static uint32_t crc32(const uint8_t *bytes, size_t n) {
    static const uint32_t table[16] = {0x00000000, 0x1DB71064, 0x3B6E20C8, 0x26D930AC, 0x76DC4190, 0x6B6B51F4,
                                       0x4DB26158, 0x5005713C, 0xEDB88320, 0xF00F9344, 0xD6D6A3E8, 0xCB61B38C,
                                       0x9B64C2B0, 0x86D3D2D4, 0xA00AE278, 0xBDBDF21C};
    uint32_t crc = 0xFFFFFFFF;
    for (size_t i = 0; i < n; i++) {
        crc ^= bytes[i];
        crc = crc >> 4 ^ table[crc & 0xF];
        crc = crc >> 4 ^ table[crc & 0xF];
    }
    return crc ^ 0xFFFFFFFF;
}

/* Undo the stuffing in place; the decoded length, or 0 if the frame is invalid. */
static size_t unstuff(uint8_t *bytes, size_t n) {
    size_t from = 0, to = 0;
    while (from < n) {
        const size_t block = bytes[from];
        if (block == 0xFF || from + block > n) return 0; /* no payload is so long, or the end is missing */
        if (from) bytes[to++] = 0;
        memmove(bytes + to, bytes + from + 1, block - 1);
        to += block - 1;
        from += block;
    }
    return to;
}

size_t ant_receive(ant_receiver *r, uint8_t byte) {
    if (byte) {
        if (r->n < sizeof r->bytes)
            r->bytes[r->n++] = byte;
        else
            r->lost = 1;
        return 0;
    }
    const size_t n = r->lost ? 0 : unstuff(r->bytes, r->n);
    const int whole = n >= ANT_HEADER_BYTES + ANT_CRC_BYTES &&
                      crc32(r->bytes, n - ANT_CRC_BYTES) == ant_get_u32(r->bytes + n - ANT_CRC_BYTES);
    if (r->n && !whole) r->damaged++;
    r->n = 0;
    r->lost = 0;
    return whole ? n - ANT_CRC_BYTES : 0;
}

size_t ant_frame(const uint8_t *payload, size_t n, uint8_t line[ANT_LINE_BYTES]) {
    uint8_t crc[ANT_CRC_BYTES];
    size_t block = 1, to = 2; /* where the length of the block that is being written goes, and its next byte */
    ant_put_u32(crc, crc32(payload, n));
    line[0] = 0;
    for (size_t i = 0; i < n + ANT_CRC_BYTES; i++) {
        const uint8_t byte = i < n ? payload[i] : crc[i - n];
        if (byte) {
            line[to++] = byte;
            continue;
        }
        line[block] = (uint8_t)(to - block);
        block = to++;
    }
    line[block] = (uint8_t)(to - block);
    line[to++] = 0;
    return to;
}
