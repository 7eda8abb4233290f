/* The board on a PC: the same board.c and frames.c behind a pseudo-terminal, with a simulated plant under them.
 *
 * It prints the terminal's name and ends when its standard input does; a line there has the torques from outside [N*m],
 * one a joint, of which it prints the first when they act. With an argument, a time in seconds, its clock advances only
 * by that time at every command: at the pace of the host, and the same in every run. */
#define _XOPEN_SOURCE 600 /* NOLINT: asks the C library for pseudo-terminals */

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "board.h"
#include "plant.h"
#include "start.h"

static ant_board board;
static ant_plant plant;
static double u[ANT_MUSCLES];
static double torque[ANT_JOINTS]; /* from outside [N*m] */
static double simulated; /* time up to which the plant is simulated [s] */
static double step;      /* advance of the clock at every command, or 0: the PC's clock [s] */
static double stepped;   /* the clock in that case [s] */
static uint32_t commands; /* that the clock has gone on for */
static int settling;     /* whether the board acts on the clock alone */
static int line = -1;    /* the board's end of the pseudo-terminal */
static uint64_t noise = 88172645463325252u; /* state of xorshift (Marsaglia 2003) */

static double now(void) {
    static struct timespec begun;
    struct timespec t;
    if (step > 0) return stepped;
    clock_gettime(CLOCK_MONOTONIC, &t);
    if (!begun.tv_sec) begun = t;
    return (double)(t.tv_sec - begun.tv_sec) + 1e-9 * (double)(t.tv_nsec - begun.tv_nsec);
}

static double uniform(void) {
    noise ^= noise << 13;
    noise ^= noise >> 7;
    noise ^= noise << 17;
    return ((double)(noise >> 11) + 0.5) / 9007199254740992.0;
}

static double normal(void) { return sqrt(-2 * log(uniform())) * cos(6.283185307179586 * uniform()); }

/* The plant up to now; pauses of the process longer than a second do not count. */
static void catch_up(void) {
    if (now() - simulated > 1) simulated = now() - 1;
    while (simulated + ANT_PLANT_DT <= now() + 1e-9) {
        ant_plant_advance(&plant, u, torque);
        simulated += ANT_PLANT_DT;
    }
}

/* --- port.h ------------------------------------------------------------------------------------------------------ */

ant_sensors read_sensors(void) {
    catch_up();
    ant_plant moved = plant; /* since its last step: at 1 rad/s a millisecond is 0.06 degrees */
    for (int i = 0; i < ANT_JOINTS; i++) moved.full[i] += moved.full[ANT_JOINTS + i] * (now() - simulated);
    const ant_plant_outputs y = ant_plant_look(&moved);
    ant_sensors s;
    for (int i = 0; i < ANT_JOINTS; i++) s.theta[i] = (float)y.theta[i];
    for (int i = 0; i < ANT_MUSCLES; i++) s.P[i] = (float)(plant.full[ANT_PLANT_P + i] + ANT_PLANT_NOISE * normal());
    return s;
}

void write_valves(const float P[ANT_MUSCLES]) {
    catch_up();
    for (int i = 0; i < ANT_MUSCLES; i++) u[i] = P[i];
}

uint32_t clock_us(void) { return (uint32_t)(uint64_t)(now() * 1e6 + 0.5); }

int receive_byte(void) {
    static uint8_t bytes[256];
    static ssize_t n, at;
    if (settling || (step > 0 && board.commands != commands)) return -1; /* until the next time */
    if (at == n) {
        at = 0;
        n = read(line, bytes, sizeof bytes);
        if (n < 0) n = 0; /* no byte, or the other end is not open yet */
    }
    return at < n ? bytes[at++] : -1;
}

void send_bytes(const uint8_t *bytes, size_t n) {
    while (n) {
        const ssize_t sent = write(line, bytes, n);
        if (sent < 0) return; /* no reader: the host will miss an answer */
        bytes += sent;
        n -= (size_t)sent;
    }
}

/* ----------------------------------------------------------------------------------------------------------------- */

/* Open a pseudo-terminal; its other end is kept open, or it would be gone whenever a host leaves. */
static const char *open_line(void) {
    struct termios raw;
    line = posix_openpt(O_RDWR | O_NOCTTY);
    if (line < 0 || grantpt(line) || unlockpt(line)) return NULL;
    const char *name = ptsname(line);
    const int other = name ? open(name, O_RDWR | O_NOCTTY) : -1;
    if (other < 0 || tcgetattr(other, &raw)) return NULL;
    raw.c_iflag = 0;
    raw.c_oflag = 0;
    raw.c_lflag = 0;
    raw.c_cflag = CS8 | CREAD | CLOCAL;
    raw.c_cc[VMIN] = 1;
    raw.c_cc[VTIME] = 0;
    if (tcsetattr(other, TCSANOW, &raw) || fcntl(line, F_SETFL, O_NONBLOCK)) return NULL;
    return name;
}

/* Read the standard input; whether to go on. */
static int listen(void) {
    static char said[32 * ANT_JOINTS];
    static size_t n;
    char bytes[64];
    const ssize_t come = read(0, bytes, sizeof bytes);
    for (ssize_t i = 0; i < come; i++) {
        if (bytes[i] != '\n') {
            if (n + 1 < sizeof said) said[n++] = bytes[i];
            continue;
        }
        said[n] = 0;
        n = 0;
        catch_up();
        char *at = said;
        for (int k = 0; k < ANT_JOINTS; k++) torque[k] = strtod(at, &at);
        printf("%g\n", torque[0]);
        fflush(stdout);
    }
    return come > 0;
}

int main(int argc, char **argv) {
    static const double start[ANT_PLANT_X] = ANT_START;
    struct pollfd waited[2] = {{0, POLLIN, 0}, {-1, POLLIN, 0}};
    step = argc > 1 ? atof(argv[1]) : 0;
    const char *name = open_line();
    if (!name || !(step >= 0)) {
        perror("no pseudo-terminal");
        return 1;
    }
    waited[1].fd = line;
    ant_plant_begin(&plant, start);
    ant_board_begin(&board);
    printf("%s\n", name);
    fflush(stdout);
    while (poll(waited, 2, 1) >= 0 || errno == EINTR) {
        if (waited[0].revents && !listen()) return 0;
        catch_up();
        ant_board_poll(&board);
        if (board.commands == commands) continue;
        commands = board.commands;
        stepped += step;
        settling = 1; /* the controller's sample comes before the next command, however soon that is there */
        catch_up();
        ant_board_poll(&board);
        settling = 0;
    }
    return 1;
}
