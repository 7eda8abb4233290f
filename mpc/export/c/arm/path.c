/* Linear model of an arm along a motion, with pressures in bar and the arguments of recursions.c. */
#include <string.h>

#include "control.h"
#include "model.h"
#include "tables.h"

enum { N = ANT_JOINTS, M = ANT_MUSCLES, S = ANT_STATES, OUTPUTS = ANT_OUTPUTS, MOVING = ANT_MOVING };

ant_qp_bounds ant_bounds_of(const ant_tuning *t) {
    const ant_qp_bounds made = {ANT_SUPPLY_LO / ANT_BAR, ANT_SUPPLY_HI / ANT_BAR, t->step / ANT_BAR,
                                ANT_LEAST_ANGLE, ANT_MOST_ANGLE, t->min_force};
    return made;
}

ant_qp_path ant_path_of(const ant_qp *qp) {
    const ant_qp_path made = {(const ant_real(*)[S])qp->motion.x, (const ant_real(*)[OUTPUTS])qp->y,
                              (const ant_real(*)[MOVING][ANT_XI])qp->A, ANT_KEPT,
                              (const ant_real(*)[OUTPUTS][S])qp->slope};
    return made;
}

/* The unit of an entry of the states and commands in the QP: bar of the pressures. */
static ant_real unit(int j) { return j < 2 * N ? 1 : ANT_BAR; }

void ant_in_units(ant_qp_memory *w) {
    for (int j = 2 * N; j < S; j++) {
        for (int k = 0; k <= ANT_HORIZON; k++) w->x[k][j] /= ANT_BAR;
        w->end[j] /= ANT_BAR;
    }
}

/* The derivatives of the outputs in the state after a sample. */
static void differentiate(ant_qp *qp, int k) {
    ant_real by[OUTPUTS][N + M];
    ant_model_gradients(qp->motion.x[k], by[0]);
    for (int row = 0; row < OUTPUTS; row++) {
        memset(qp->slope[k][row], 0, sizeof qp->slope[k][row]);
        for (int i = 0; i < N; i++) qp->slope[k][row][i] = by[row][i];
        for (int j = 0; j < M; j++) qp->slope[k][row][2 * N + j] = ANT_BAR * by[row][N + j];
    }
    memcpy(qp->y[k], qp->motion.K[k], sizeof qp->motion.K[k]);
    memcpy(qp->y[k] + ANT_STIFFNESSES, qp->motion.F[k], sizeof qp->motion.F[k]);
}

int ant_linearise(ant_controller *c, const ant_task *task) {
    ant_qp *qp = &c->qp;
    ant_motion *m = &qp->motion;
    memcpy(m->x[0], task->x, sizeof m->x[0]);
    for (int k = 0; k < ANT_HORIZON; k++) {
        ant_real A[S][S], B[S][M], by_d[S][N];
        ant_model_slopes(m->x[k], m->u[k], task->d[k], m->x[k + 1], A[0], B[0], by_d[0]);
        for (int i = 0; i < MOVING; i++)
            for (int j = 0; j < ANT_XI; j++)
                qp->A[k][i][j] = unit(j) / unit(i) * (j < S ? A[i][j] : B[i][j - S]);
        for (int j = 0; j < M; j++) qp->u[k][j] = m->u[k][j] / ANT_BAR;
    }
    for (int k = 0; k <= ANT_HORIZON; k++) {
        ant_model_outputs(m->x[k], m->K[k], m->F[k]);
        differentiate(qp, k);
    }
    return c->feed.finite && ant_finite(m->x[0], S * (ANT_HORIZON + 1)) &&
           ant_finite(qp->A[0][0], MOVING * ANT_XI * ANT_HORIZON) &&
           ant_finite(qp->y[0], OUTPUTS * (ANT_HORIZON + 1)) &&
           ant_finite(qp->slope[0][0], OUTPUTS * S * (ANT_HORIZON + 1));
}
