/* Rate of a joint's state, x' = f(x, u, d), and of its derivatives, S' = df/dx S + (0, df/du, df/dd); model.c has them
 * as formulas. */
#include <string.h>

#include "model.h"

void ant_rate(const ant_real *y, int length, const ant_real *x, const ant_real *u, const ant_real *d, int step,
              int place, ant_real *rate) {
    (void)x, (void)step, (void)place;
    if (length == ANT_MOVING)
        ant_model_rate(y, u, d, rate);
    else
        ant_model_variational(y, u, d, rate);
}

void ant_model_stage(const ant_real *x, const ant_real *u, const ant_real *d, ant_real *later) {
    memcpy(later, x, ANT_MOVING * sizeof *x);
    ant_advance(later, ANT_MOVING, x, u, d);
}

void ant_model_slopes(const ant_real *x, const ant_real *u, const ant_real *d, ant_real *later, ant_real *A,
                      ant_real *B, ant_real *by_d) {
    ant_real y[ANT_VARIED];
    ant_model_begun(x, y);
    ant_advance(y, ANT_VARIED, x, u, d);
    ant_model_ended(y, later, A, B, by_d);
}
