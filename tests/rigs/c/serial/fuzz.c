/* A board that hears what is in one file, a byte at a time, and writes every command that it accepts to another: rows
 * of doubles. A row is 0 and the pressures of a WRITE, or 1 and the references of a sample; zeros fill it. */
#include <math.h>
#include <stdio.h>

#include "board.h"

static ant_board board;
static FILE *from, *to;
static int over, pause;
static uint32_t now; /* [us]; one for every byte */
enum { COLUMNS = 1 + ANT_MUSCLES }; /* of a row; there are no more references than muscles */
static float valves[ANT_MUSCLES];

ant_sensors read_sensors(void) {
    ant_sensors s = {{0.1f}, {2e5f}};
    s.P[ANT_MUSCLES - 1] = NAN;
    return s;
}

void write_valves(const float P[ANT_MUSCLES]) {
    for (int i = 0; i < ANT_MUSCLES; i++) valves[i] = P[i];
}

uint32_t clock_us(void) { return now; }

int receive_byte(void) {
    pause = !pause;
    if (pause) return -1; /* one in every poll */
    const int byte = fgetc(from);
    over = byte == EOF;
    now++;
    return over ? -1 : byte;
}

void send_bytes(const uint8_t *bytes, size_t n) {
    for (size_t i = 1; i + 1 < n; i++)
        if (bytes[i] == 0) over = 1; /* a zero within a frame would be the end of it */
}

static void put(double kind, const float *one, int n, const float *two, int more) {
    double row[COLUMNS] = {kind};
    for (int i = 0; i < n; i++) row[1 + i] = one[i];
    for (int i = 0; i < more; i++) row[1 + n + i] = two[i];
    if (fwrite(row, sizeof row, 1, to) != 1) over = 1;
}

int main(int argc, char **argv) {
    uint32_t commands = 0;
    from = argc == 3 ? fopen(argv[1], "rb") : NULL;
    to = argc == 3 ? fopen(argv[2], "wb") : NULL;
    if (from == NULL || to == NULL) return 1;
    ant_board_begin(&board);
#ifdef ANT_BOARD_CONTROLS
    uint32_t have = 0;
#endif
    while (!over) {
        ant_board_poll(&board);
        if (board.commands != commands && board.state == ANT_STATE_DIRECT) put(0, valves, ANT_MUSCLES, NULL, 0);
        commands = board.commands;
#ifdef ANT_BOARD_CONTROLS
        if (board.follower.have < have) have = 0;
        for (; have < board.follower.have; have++)
            put(1, board.follower.theta[have % ANT_ROOM], ANT_JOINTS, board.follower.K[have % ANT_ROOM], ANT_STIFFNESSES);
#endif
    }
    if (!feof(from)) return 2;
    return fclose(from) || fclose(to);
}
