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
        ANT_LAZY,
        ANT_ACCURACY,
        t->slack,
        ANT_STARTS,
    };
    return made;
}

ant_structured ant_structured_of(ant_qp *qp) {
    ant_sweeps *s = &qp->work.structured.sweeps;
    ant_iteration *i = &qp->work.structured.work.iteration;
    ant_exchange *a = &qp->work.structured.work.exchange;
    const ant_qp_sweep sweep = {s->R, s->D, s->g, s->feedback, s->held, s->gx, s->gv, s->r, s->inverse};
    const ant_structured made = {
        setting_of(qp->tuning),
        {(const ant_real(*)[4])qp->motion.x, (const ant_real(*)[3])qp->y, (const ant_real(*)[4][4])qp->A,
         (const ant_real(*)[4][2])qp->B, (const ant_real(*)[3][4])qp->slope},
        {s->x, s->y, s->e, s->change, s->end},
        {qp->lower, qp->upper, qp->there},
        (const ant_real(*)[2])qp->u,
        {s->xi, s->v, s->sigma},
        {{i->span, i->b, i->t, i->multiplier, i->W, i->residual, i->push, i->dt, i->change},
         {s->R, s->feedback, i->border, s->D, i->border_sigma},
         {i->xi, i->v, i->sigma},
         sweep,
         s->gx,
         s->gv,
         s->r,
         i->first,
         i->origin_x,
         i->origin_v,
         {i->origin_x, i->origin_v, i->first[0]}},
        {a->base,
         a->held,
         a->lower,
         a->upper,
         a->z,
         a->r,
         a->dz,
         a->dr,
         a->b,
         a->value,
         a->xi,
         a->first,
         {a->other_xi, a->other_v, a->other_sigma},
         {a->item_z, a->item_r, a->K, a->kind, a->sample, a->muscle, a->side, a->multiplier, a->step, a->L, a->order, a->known, a->item_p}}};
    return made;
}

void ant_decisions(const ant_qp *qp, ant_real z[ANT_DECISIONS]) {
    for (int b = 0; b < ANT_BLOCKS; b++)
        memcpy(z + 2 * b, qp->work.structured.sweeps.v[ANT_STARTS[b]], sizeof qp->work.structured.sweeps.v[0]);
    z[ANT_MOVES] = z[ANT_MOVES + 1] = 0;
}

int ant_linearise(ant_controller *c, const ant_task *task, const ant_real u_last[2]) {
    ant_qp *qp = &c->qp;
    if (!ant_rollout(task->x, task->d, &qp->motion) || !c->feed.finite) return 0;
    for (int k = 0; k < ANT_HORIZON; k++) {
        ant_model_slopes(qp->motion.x[k], qp->motion.u[k], &task->d[k], qp->A[k][0], qp->B[k][0]);
        ant_model_gradients(qp->motion.x[k + 1], qp->slope[k + 1][0], qp->slope[k + 1][1]);
        for (int i = 0; i < 2; i++) {
            for (int j = 0; j < 4; j++) qp->B[k][j][i] *= ANT_BAR;
            qp->u[k][i] = qp->motion.u[k][i] / ANT_BAR;
            qp->y[k + 1][1 + i] = qp->motion.F[k + 1][i];
        }
        qp->y[k + 1][0] = qp->motion.K[k + 1];
    }
    const ant_real *star = c->starred ? c->u_star : c->feed.u[0];
    const ant_real last[2][2] = {{u_last[0], u_last[1]}, {star[0], star[1]}};
    const ant_qp_bounded bounded = {qp->lower, qp->upper, qp->there};
    const ant_qp_setting setting = setting_of(qp->tuning);
    ant_slew_bounds(&setting, (const ant_real(*)[2])qp->u, last, &bounded);
    return ant_finite(qp->A[0][0], 16 * ANT_HORIZON) && ant_finite(qp->B[0][0], 8 * ANT_HORIZON) &&
           ant_finite(qp->slope[1][0], 12 * ANT_HORIZON);
}

void ant_expect_shifted(ant_controller *c) {
    for (int b = 0; b + 1 < ANT_BLOCKS; b++)
        if (ANT_STARTS[b + 1] == ANT_STARTS[b] + 1) memcpy(c->qp.guess + 2 * b, c->qp.guess + 2 * b + 2, 2);
}

void ant_deviate(const ant_controller *c, const ant_structured *s, const ant_real u_last[2]) {
    const ant_real *star = c->starred ? c->u_star : c->feed.u[0];
    const ant_real last[2][2] = {{u_last[0], u_last[1]}, {star[0], star[1]}};
    const ant_qp_reference reference = {(const ant_real(*)[4])c->feed.x, (const ant_real(*)[3])c->feed.y,
                                        (const ant_real(*)[2])c->feed.u};
    ant_deviations(&s->path, s->u, &reference, last, &s->errors);
    memset(s->at.sigma, 0, 2 * sizeof s->at.sigma[0]);
}

ant_plan_status ant_solve(ant_controller *c, const ant_real u_last[2], ant_real z[ANT_DECISIONS], int *iterations) {
    const ant_structured s = ant_structured_of(&c->qp);
    *iterations = 0;
    if (c->iteration_limit <= 0) return ANT_PLAN_UNSOLVED;
    ant_deviate(c, &s, u_last);
    const int count = ant_swept(&s.path, &s.errors, &s.setting, s.u, &s.bounded, c->qp.guess, &s.at, &s.work.sweep,
                                &s.active);
    if (count > 0) return ant_persist(c, u_last, count, z, iterations);
    ant_decisions(&c->qp, z);
    return ANT_PLAN_OPTIMAL;
}
