/* Motion of a machine over a sample of constant commands, by the classical Runge-Kutta method. */
#include "motion.h"

#include <string.h>

#include "real.h"
#include "settings.h"

void ant_advance(ant_real *y, int length, const ant_real *x, const ant_real *u, const ant_real *d) {
    static const ant_real reaches[4] = {ANT_R(0.5), ANT_R(0.5), 1, 0}; /* to the next stage */
    static const ant_real shares[4] = {ANT_R(1.0) / 6, ANT_R(1.0) / 3, ANT_R(1.0) / 3, ANT_R(1.0) / 6};
    static const int places[4] = {0, 1, 1, 2};
    const ant_real h = ANT_DT / ANT_SUBSTEPS;
    ant_real now[ANT_VARIED], rate[ANT_VARIED], sum[ANT_VARIED]; /* one rounding of y a step */
    for (int step = 0; step < ANT_SUBSTEPS; step++) {
        memcpy(now, y, (size_t)length * sizeof *y);
        memset(sum, 0, (size_t)length * sizeof *y);
        for (int part = 0; part < 4; part++) {
            const ant_real reach = h * reaches[part], share = h * shares[part];
            ant_rate(now, length, x, u, d, step, places[part], rate);
            for (int i = 0; i < length; i++) {
                sum[i] += share * rate[i];
                now[i] = y[i] + reach * rate[i];
            }
        }
        for (int i = 0; i < length; i++) y[i] += sum[i];
    }
}
