/* Reads postures from one file and writes the terms of ant_stiffness_at to another: rows of doubles. */
#include <stdio.h>

#include "antagonist.h"

int main(int argc, char **argv) {
    double in[4];
    FILE *from = argc == 3 ? fopen(argv[1], "rb") : NULL, *to = argc == 3 ? fopen(argv[2], "wb") : NULL;
    if (from == NULL || to == NULL) return 1;
    while (fread(in, sizeof in, 1, from) == 1) {
        const ant_stiffness s =
            ant_stiffness_at((ant_real)in[0], (ant_real)in[1], (ant_real)in[2], (ant_real)in[3]);
        const double out[5] = {s.K, s.hysteresis, s.gas[0], s.gas[1], s.loss};
        if (fwrite(out, sizeof out, 1, to) != 1) return 2;
    }
    return fclose(from) || fclose(to);
}
