/* The rollout is the motion that the model expects. */
#include <string.h>

#include "control.h"
#include "model.h"

int ant_finite(const ant_real *numbers, int n) {
    for (int i = 0; i < n; i++)
        if (!isfinite(numbers[i])) return 0;
    return 1;
}

int ant_rollout(const ant_real x0[ANT_STATES], const ant_real (*d)[ANT_JOINTS], ant_motion *m) {
    enum { after = ANT_HORIZON + 1 };
    memcpy(m->x[0], x0, sizeof m->x[0]);
    for (int k = 0; k < ANT_HORIZON; k++) ant_model_stage(m->x[k], m->u[k], d[k], m->x[k + 1]);
    for (int k = 0; k < after; k++) ant_model_outputs(m->x[k], m->K[k], m->F[k]);
    return ant_finite(m->u[0], ANT_MUSCLES * ANT_HORIZON) && ant_finite(m->x[0], ANT_STATES * after) &&
           ant_finite(m->K[0], ANT_STIFFNESSES * after) && ant_finite(m->F[0], ANT_MUSCLES * after);
}
