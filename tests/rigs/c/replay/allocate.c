/* Reads targets from one file and writes what ant_allocate answers to another:
 * rows of doubles. */
#include <stdio.h>

#include "antagonist.h"

int main(int argc, char **argv) {
    double in[9];
    FILE *from = argc == 3 ? fopen(argv[1], "rb") : NULL, *to = argc == 3 ? fopen(argv[2], "wb") : NULL;
    if (from == NULL || to == NULL) return 1;
    while (fread(in, sizeof in, 1, from) == 1) {
        const ant_target target = {
            (ant_real)in[0], (ant_real)in[1], (ant_real)in[2],
            (ant_real)in[3], (ant_real)in[4], (ant_real)in[5],
            (ant_real)in[6], (ant_real)in[7], in[8] > 0 ? ANT_STIFFNESS_FIRST : ANT_TORQUE_FIRST};
        const ant_allocation a = ant_allocate(&target);
        const double out[6] = {a.P1, a.P2, a.T, a.K, a.status, a.limits};
        if (fwrite(out, sizeof out, 1, to) != 1) return 2;
    }
    return fclose(from) || fclose(to);
}
