/* The limits are what commands, angle and muscle forces have to keep to. */
#include "control.h"

/* The slew limit comes first: from outside the supply's range commands return as fast as it lets them. */
void ant_limit(ant_real step, const ant_real u_last[2], ant_real u[ANT_HORIZON][2]) {
    for (int i = 0; i < 2; i++) {
        ant_real last = u_last[i];
        for (int k = 0; k < ANT_HORIZON; k++) {
            last = ant_clip(ant_clip(u[k][i], ANT_SUPPLY_LO, ANT_SUPPLY_HI), last - step, last + step);
            u[k][i] = last;
        }
    }
}

ant_real ant_excursion(const ant_motion *m) {
    ant_real worst = 0;
    for (int k = 0; k <= ANT_HORIZON; k++) {
        if (ANT_LEFT - m->x[k][0] > worst) worst = ANT_LEFT - m->x[k][0];
        if (m->x[k][0] - ANT_RIGHT > worst) worst = m->x[k][0] - ANT_RIGHT;
    }
    return worst;
}

ant_real ant_slackening(ant_real min_force, const ant_motion *m) {
    ant_real worst = 0;
    for (int k = 1; k <= ANT_HORIZON; k++)
        for (int i = 0; i < 2; i++)
            if (min_force - m->F[k][i] > worst) worst = min_force - m->F[k][i];
    return worst;
}
