/* Two muscles affine in the pressure, F = A P + B, in any geometry. */
#include "exact.h"
#include "joint.h"
#include "model.h"
#include "real.h"

ant_answer ant_exact(const ant_target *t) {
    const ant_real theta = ant_clip(t->theta, ANT_LEFT, ANT_RIGHT);
    ant_real one[5], two[5]; /* of each muscle there: A, B, moment arm, stiffness per pressure and without */
    ant_model_sides(&theta, one, two);
    return ant_affine_exact(t->theta, t->K, t->T, one, two, t->min_force, t->max_force, t->P1_now, t->P2_now,
                            t->max_step, t->priority == ANT_STIFFNESS_FIRST);
}
