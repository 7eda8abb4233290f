/* Reads samples from one file and writes what ant_step answers to another, with the tuning in a third, if there is one:
 * rows of doubles. */
#include <stdio.h>

#include "samples.h"
#include "settings.h"
#include "tuning_file.h"

enum {
    BOUND = ANT_ITERATIONS * ANT_EXCHANGES,
    SHOWN = ANT_MUSCLES + 7 + ANT_SENSORS
};

static ant_controller controller;
static ant_sample sample;
static ant_plan plan;
static double in[ANT_SAMPLE], out[SHOWN];

static double *give(const ant_real *from, double *to, int count) {
    for (int i = 0; i < count; i++) to[i] = (double)from[i];
    return to + count;
}

int main(int argc, char **argv) {
    FILE *from = argc >= 3 ? fopen(argv[1], "rb") : NULL, *to = argc >= 3 ? fopen(argv[2], "wb") : NULL;
    static ant_tuning tuning;
    if (from == NULL || to == NULL) return 1;
    ant_reset(&controller);
    if (argc > 3 && !(ant_read_tuning(argv[3], &tuning) && ant_tune(&controller, &tuning))) return 4;
    while (fread(in, sizeof in, 1, from) == 1) {
        ant_sample_of(in, &sample);
        controller.exchange_limit = sample.fails ? 0 : ANT_EXCHANGES;
        ant_step(&controller, &sample.reading, &sample.reference, &plan);
        if (plan.exchanges > BOUND || (controller.exchange_limit == 0 && plan.exchanges > 0)) return 3;
        double *next = give(plan.u[0], out, ANT_MUSCLES);
        *next++ = plan.status;
        *next++ = plan.rung;
        next = give(&plan.slack, next, 1);
        next = give(&plan.slack_force, next, 1);
        next = give(plan.moved, next, 3);
        for (int i = 0; i < ANT_SENSORS; i++) *next++ = controller.observer.verdicts[i];
        if (fwrite(out, sizeof out, 1, to) != 1) return 2;
    }
    return fclose(from) || fclose(to);
}
