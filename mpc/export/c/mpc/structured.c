/* The QP of a step, sample by sample, with the arguments of recursions.c; and its solution. */
#include <string.h>

#include "control.h"
#include "tables.h"

void ant_expect_shifted(ant_controller *c) {
    enum { m = ANT_MUSCLES };
    for (int b = 0; b + 1 < ANT_BLOCKS; b++)
        if (ANT_STARTS[b + 1] == ANT_STARTS[b] + 1) memcpy(c->qp.guess + m * b, c->qp.guess + m * b + m, m);
}

ant_qp_setting ant_setting_of(const ant_tuning *t) {
    const ant_qp_setting made = {{t->x, t->y, t->e, t->change, t->end}, ant_bounds_of(t), t->curvature, ANT_EXCHANGES,
                                 ANT_ACCURACY, t->slack, ANT_STARTS};
    return made;
}

ant_plan_status ant_solve(ant_controller *c, const ant_real u_last[ANT_MUSCLES], ant_real z[ANT_MOVES],
                          ant_plan *plan) {
    ant_qp *qp = &c->qp;
    ant_qp_memory *w = &qp->work;
    ant_real last[2][ANT_MUSCLES];
    memcpy(last[0], u_last, sizeof last[0]);
    memcpy(last[1], c->starred ? c->u_star : c->feed.u[0], sizeof last[1]);
    const ant_qp_reference reference = {(const ant_real(*)[ANT_STATES])c->feed.x,
                                        (const ant_real(*)[ANT_OUTPUTS])c->feed.y,
                                        (const ant_real(*)[ANT_MUSCLES])c->feed.u};
    const ant_qp_setting setting = ant_setting_of(qp->tuning);
    const ant_qp_path path = ant_path_of(qp);
    const ant_qp_errors errors = {w->x, w->y, w->e, w->change, w->end};
    const ant_qp_bounded bounded = {w->lower, w->upper, w->low, w->high, w->there};
    const ant_qp_point at = {w->xi, w->v, w->sigma};
    const ant_qp_sweep sweep = {w->R, w->D, w->g, w->feedback, w->base, w->gx, w->gv, w->inverse,
                                w->by_xi, w->by_v, w->command_charge, w->change_charge, w->row_charge};
    const ant_qp_active active = {w->held, w->guessed, w->z, w->r, w->dz, w->dr, w->answer,
                                  {w->item_z, w->item_r, w->K, w->kind, w->sample, w->muscle, w->side, w->multiplier,
                                   w->step, w->L, w->order, w->known, w->item_p}};
    const int limit = c->exchange_limit < ANT_EXCHANGES ? c->exchange_limit : ANT_EXCHANGES;
    ant_deviations(&path, (const ant_real(*)[ANT_MUSCLES])qp->u, &reference, (const ant_real(*)[ANT_MUSCLES])last,
                   &errors);
    ant_in_units(w);
    ant_change_bounds(&setting, (const ant_real(*)[ANT_MUSCLES])qp->u, (const ant_real(*)[ANT_MUSCLES])last, &bounded);
    const ant_settle_numbers found =
        ant_settle(&path, &errors, &setting, &bounded, qp->guess, &at, &sweep, &active, limit);
    for (int b = 0; b < ANT_BLOCKS; b++) memcpy(z + ANT_MUSCLES * b, w->v[ANT_STARTS[b]], sizeof w->v[0]);
    plan->exchanges += found._1;
    plan->gap = found._0 ? 0 : found._2;
    return found._0 ? ANT_PLAN_OPTIMAL : ANT_PLAN_UNSOLVED;
}
