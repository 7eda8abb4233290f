/* The QP of a step, sample by sample, with the arguments of recursions.c; and its solution. */
#include <string.h>

#include "control.h"
#include "model.h"
#include "tables.h"

static ant_qp_setting setting_of(const ant_tuning *t) {
    const ant_qp_setting made = {
        {t->x, t->y, t->e, t->change, t->end},
        {ANT_SUPPLY_LO / ANT_BAR, ANT_SUPPLY_HI / ANT_BAR, t->step / ANT_BAR, ANT_LEFT, ANT_RIGHT, t->min_force},
        t->curvature,
        ANT_EXCHANGES,
        ANT_ACCURACY,
        t->slack,
        ANT_STARTS,
    };
    return made;
}

int ant_linearise(ant_controller *c, const ant_task *task) {
    ant_qp *qp = &c->qp;
    ant_real later[4], by_d[4];
    if (!ant_rollout(task->x, task->d, &qp->motion) || !c->feed.finite) return 0;
    for (int k = 0; k < ANT_HORIZON; k++) {
        ant_model_slopes(qp->motion.x[k], qp->motion.u[k], &task->d[k], later, qp->A[k][0], qp->B[k][0], by_d);
        ant_model_gradients(qp->motion.x[k + 1], qp->slope[k + 1][0], qp->slope[k + 1][1]);
        for (int i = 0; i < 2; i++) {
            for (int j = 0; j < 4; j++) qp->B[k][j][i] *= ANT_BAR;
            qp->u[k][i] = qp->motion.u[k][i] / ANT_BAR;
            qp->y[k + 1][1 + i] = qp->motion.F[k + 1][i];
        }
        qp->y[k + 1][0] = qp->motion.K[k + 1];
    }
    return ant_finite(qp->A[0][0], 16 * ANT_HORIZON) && ant_finite(qp->B[0][0], 8 * ANT_HORIZON) &&
           ant_finite(qp->slope[1][0], 12 * ANT_HORIZON);
}

void ant_expect_shifted(ant_controller *c) {
    for (int b = 0; b + 1 < ANT_BLOCKS; b++)
        if (ANT_STARTS[b + 1] == ANT_STARTS[b] + 1) memcpy(c->qp.guess + 2 * b, c->qp.guess + 2 * b + 2, 2);
}

ant_plan_status ant_solve(ant_controller *c, const ant_real u_last[2], ant_real z[ANT_MOVES], ant_plan *plan) {
    ant_qp *qp = &c->qp;
    ant_work *w = &qp->work;
    const ant_real *star = c->starred ? c->u_star : c->feed.u[0];
    const ant_real last[2][2] = {{u_last[0], u_last[1]}, {star[0], star[1]}};
    const ant_qp_reference reference = {(const ant_real(*)[4])c->feed.x, (const ant_real(*)[3])c->feed.y,
                                        (const ant_real(*)[2])c->feed.u};
    const ant_qp_setting setting = setting_of(qp->tuning);
    const ant_qp_path path = {(const ant_real(*)[4])qp->motion.x, (const ant_real(*)[3])qp->y,
                              (const ant_real(*)[4][4])qp->A, (const ant_real(*)[4][2])qp->B,
                              (const ant_real(*)[3][4])qp->slope};
    const ant_qp_errors errors = {w->x, w->y, w->e, w->change, w->end};
    const ant_qp_bounded bounded = {w->lower, w->upper, w->low, w->high, w->there};
    const ant_qp_point at = {w->xi, w->v, w->sigma};
    const ant_qp_sweep sweep = {w->R, w->D, w->g, w->feedback, w->base, w->gx, w->gv, w->inverse, w->by_xi, w->by_v};
    const ant_qp_active active = {w->held, w->guessed, w->z, w->r, w->dz, w->dr, w->answer,
                                  {w->item_z, w->item_r, w->K, w->kind, w->sample, w->muscle, w->side, w->multiplier,
                                   w->step, w->L, w->order, w->known, w->item_p}};
    const int limit = c->exchange_limit < ANT_EXCHANGES ? c->exchange_limit : ANT_EXCHANGES;
    ant_deviations(&path, (const ant_real(*)[2])qp->u, &reference, last, &errors);
    ant_change_bounds(&setting, (const ant_real(*)[2])qp->u, last, &bounded);
    const ant_settle_numbers found =
        ant_settle(&path, &errors, &setting, &bounded, qp->guess, &at, &sweep, &active, limit);
    for (int b = 0; b < ANT_BLOCKS; b++) memcpy(z + 2 * b, w->v[ANT_STARTS[b]], sizeof w->v[0]);
    plan->exchanges += found._1;
    plan->gap = found._0 ? 0 : found._2;
    return found._0 ? ANT_PLAN_OPTIMAL : ANT_PLAN_UNSOLVED;
}
