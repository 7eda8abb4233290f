/* Reads samples from one file and writes what ant_step answers to another, with the tuning in a third, if there is one:
 * rows of doubles. A sample is the reading (theta, P1, P2), whether the QP solver is to fail, and the reference. */
#include <stdio.h>

#include "antagonist.h"
#include "settings.h"
#include "tuning_file.h"

enum { BOUND = ANT_ITERATIONS * ANT_EXCHANGES };

static ant_controller controller;
static double in[4 + 2 * (ANT_AHEAD + 1)];

int main(int argc, char **argv) {
    FILE *from = argc >= 3 ? fopen(argv[1], "rb") : NULL, *to = argc >= 3 ? fopen(argv[2], "wb") : NULL;
    static ant_tuning tuning;
    if (from == NULL || to == NULL) return 1;
    ant_reset(&controller);
    if (argc > 3 && !(ant_read_tuning(argv[3], &tuning) && ant_tune(&controller, &tuning))) return 4;
    while (fread(in, sizeof in, 1, from) == 1) {
        const ant_reading reading = {(ant_real)in[0], (ant_real)in[1], (ant_real)in[2]};
        static ant_reference reference;
        static ant_plan plan;
        controller.exchange_limit = in[3] != 0 ? 0 : ANT_EXCHANGES;
        for (int k = 0; k <= ANT_AHEAD; k++) {
            reference.theta[k] = (ant_real)in[4 + k];
            reference.K[k] = (ant_real)in[4 + ANT_AHEAD + 1 + k];
        }
        ant_step(&controller, &reading, &reference, &plan);
        if (plan.exchanges > BOUND || (controller.exchange_limit == 0 && plan.exchanges > 0)) return 3;
        const ant_verdict *verdicts = controller.observer.verdicts;
        const double out[12] = {plan.u[0][0], plan.u[0][1],     plan.status,   plan.rung,
                                plan.slack,   plan.slack_force, plan.moved[0], plan.moved[1],
                                plan.moved[2], verdicts[0],     verdicts[1],   verdicts[2]};
        if (fwrite(out, sizeof out, 1, to) != 1) return 2;
    }
    return fclose(from) || fclose(to);
}
