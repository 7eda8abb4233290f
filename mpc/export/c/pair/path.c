/* Linear model of a joint along a motion, with the arguments of recursions.c. */
#include "control.h"
#include "model.h"
#include "tables.h"

ant_qp_bounds ant_bounds_of(const ant_tuning *t) {
    const ant_qp_bounds made = {ANT_SUPPLY_LO / ANT_BAR, ANT_SUPPLY_HI / ANT_BAR, t->step / ANT_BAR,
                                ANT_LEAST_ANGLE[0], ANT_MOST_ANGLE[0], t->min_force};
    return made;
}

ant_qp_path ant_path_of(const ant_qp *qp) {
    const ant_qp_path made = {(const ant_real(*)[4])qp->motion.x, (const ant_real(*)[3])qp->y,
                              (const ant_real(*)[4][4])qp->A, (const ant_real(*)[4][2])qp->B,
                              (const ant_real(*)[3][4])qp->slope};
    return made;
}

void ant_in_units(ant_qp_memory *w) { (void)w; } /* errors are in those of the model */

int ant_linearise(ant_controller *c, const ant_task *task) {
    ant_qp *qp = &c->qp;
    ant_real later[4], by_d[4];
    if (!ant_rollout(task->x, task->d, &qp->motion) || !c->feed.finite) return 0;
    for (int k = 0; k < ANT_HORIZON; k++) {
        ant_model_slopes(qp->motion.x[k], qp->motion.u[k], task->d[k], later, qp->A[k][0], qp->B[k][0], by_d);
        ant_model_gradients(qp->motion.x[k + 1], qp->slope[k + 1][0], qp->slope[k + 1][1]);
        for (int i = 0; i < 2; i++) {
            for (int j = 0; j < 4; j++) qp->B[k][j][i] *= ANT_BAR;
            qp->u[k][i] = qp->motion.u[k][i] / ANT_BAR;
            qp->y[k + 1][1 + i] = qp->motion.F[k + 1][i];
        }
        qp->y[k + 1][0] = qp->motion.K[k + 1][0];
    }
    return ant_finite(qp->A[0][0], 16 * ANT_HORIZON) && ant_finite(qp->B[0][0], 8 * ANT_HORIZON) &&
           ant_finite(qp->slope[1][0], 12 * ANT_HORIZON);
}
