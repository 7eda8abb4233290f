/* Tuning while the program runs: checks, and reading from numbers. */
#include <string.h>

#include "control.h"

static int positive(const ant_real *numbers, int count, int zero_too) {
    for (int i = 0; i < count; i++)
        if (!(isfinite(numbers[i]) && (zero_too ? numbers[i] >= 0 : numbers[i] > 0))) return 0;
    return 1;
}

int ant_tune(ant_controller *c, const ant_tuning *t) {
    int good = positive(t->x, ANT_STATES, 1) && positive(t->y, ANT_OUTPUTS, 1);
    good = good && positive(t->e, ANT_MUSCLES, 0) && positive(t->change, ANT_MUSCLES, 0);
    good = good && positive(t->slack, 4, 0) && positive(&t->step, 1, 0) && positive(&t->min_force, 1, 1);
    good = good && positive(&t->curvature, 1, 0) && ant_finite(t->end[0], ANT_XI * ANT_XI);
    for (int i = 0; i < ANT_XI; i++) good = good && t->end[i][i] > 0;
    if (good) c->qp.tuning = t;
    return good;
}

static int near(ant_real a, ant_real b, ant_real share) { return ant_abs(a - b) <= share * ant_abs(b); }

int ant_tuning_from(const ant_real *numbers, int count, ant_tuning *t) {
    if (count != ANT_TUNING_NUMBERS) return 0;
    if (!near(numbers[0], ANT_DT, ANT_R(1e-6)) || !near(numbers[1], ANT_PLANT, ANT_R(1e-4))) return 0;
    memcpy(t, numbers + 2, sizeof *t); /* all its fields are ant_real */
    return 1;
}
