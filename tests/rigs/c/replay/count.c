/* Reads samples and writes, for each step, the multiplications in recursions.c (counted.cpp) and the exchanges. */
#include <stdio.h>

#include "samples.h"

extern long ant_counted;
static ant_controller controller;
static ant_sample sample;
static ant_plan plan;

int main(int argc, char **argv) {
    double in[ANT_SAMPLE];
    FILE *from = argc == 3 ? fopen(argv[1], "rb") : NULL, *to = argc == 3 ? fopen(argv[2], "wb") : NULL;
    if (from == NULL || to == NULL) return 1;
    ant_reset(&controller);
    while (fread(in, sizeof in, 1, from) == 1) {
        ant_sample_of(in, &sample);
        ant_counted = 0;
        ant_step(&controller, &sample.reading, &sample.reference, &plan);
        const double out[2] = {(double)ant_counted, plan.exchanges};
        if (fwrite(out, sizeof out, 1, to) != 1) return 2;
    }
    return fclose(from) || fclose(to);
}
