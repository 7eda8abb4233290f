/* The QP of a step,
 *
 *     minimise   |R z + v|^2/2 + price of the slacks    over the moves and the slacks s, s_F >= 0
 *     subject to lower <= z <= upper and the rows of rows.c,
 *
 * by DAQP (D. Arnstrom, src/daqp), a dual active-set method that finds the exact solution in a finite number of
 * iterations, every one a rank-one update. DAQP takes the problem as the least distance |u|, u = R z + v. Rows seldom
 * bind: each is left out until a solution violates it; then the method continues with the row. */
#include <string.h>

#include "dense.h"
#include "daqp_core.h"

static const ant_real FAR = ANT_R(1e30); /* DAQP's infinity */
enum { REFINEMENTS = 3 };

static void settings(DAQPSettings *s, int iteration_limit) {
    memset(s, 0, sizeof *s);
    s->primal_tol = ANT_R(2e-6);
    s->dual_tol = ANT_R(1e-6);
    s->zero_tol = ANT_R(1e-7);
    s->pivot_tol = ANT_R(1e-4);
    s->progress_tol = ANT_R(1e-6);
    s->sing_tol = ANT_R(1e-6);
    s->refactor_tol = ANT_R(1e-5);
    s->cycle_tol = DAQP_DEFAULT_CYCLE_TOL;
    s->fval_bound = DAQP_INF;
    s->iter_limit = iteration_limit;
}

/* R^-1 (packed) and v with the slacks, whose part of R is diagonal. */
static void invert(const ant_qp *qp, ant_solver *s) {
    enum { n = ANT_DECISIONS, moves = ANT_MOVES };
    memset(s->Rinv, 0, sizeof s->Rinv);
    for (int j = 0; j < moves; j++) { /* column by column from the diagonal up */
        s->Rinv[ant_at(n, j) + j] = 1 / qp->work.dense.R[ant_at(moves, j) + j];
        for (int i = j - 1; i >= 0; i--) {
            const ant_real *Ri = qp->work.dense.R + ant_at(moves, i);
            ant_real sum = 0;
            for (int l = i + 1; l <= j; l++) sum += Ri[l] * s->Rinv[ant_at(n, l) + j];
            s->Rinv[ant_at(n, i) + j] = -sum / Ri[i];
        }
    }
    memcpy(s->v, qp->work.dense.v, sizeof qp->work.dense.v);
    for (int i = 0; i < 2; i++) {
        const ant_real *price = qp->tuning->slack + 2 * i, root = ANT_F(sqrt)(price[1]);
        s->Rinv[ant_at(n, moves + i) + moves + i] = 1 / root;
        s->v[moves + i] = price[0] / root;
    }
}

/* Limit `id`, lower <= m (u - v) <= upper, its row m made a unit vector as DAQP likes it. */
static void set_limit(ant_solver *s, int id, ant_real *m, int first, ant_real lower, ant_real upper) {
    ant_real square = 0, shift = 0;
    for (int j = first; j < ANT_DECISIONS; j++) square += m[j] * m[j];
    s->scaling[id] = square > 0 ? 1 / ANT_F(sqrt)(square) : 1;
    for (int j = first; j < ANT_DECISIONS; j++) {
        m[j] *= s->scaling[id];
        shift += m[j] * s->v[j];
    }
    s->dlower[id] = isfinite(lower) ? lower * s->scaling[id] + shift : -FAR;
    s->dupper[id] = isfinite(upper) ? upper * s->scaling[id] + shift : FAR;
}

/* Row i joins: its m is the row times the scaled R^-1. */
static void let_in(const ant_qp *qp, ant_solver *s, int i) {
    ant_real row[ANT_DECISIONS], *m = s->M[s->rows];
    const int id = ANT_DECISIONS + s->rows;
    const ant_bound at = ant_bound_of(qp, ANT_DECISIONS + i);
    ant_row(qp, i, row);
    for (int j = 0; j < ANT_DECISIONS; j++) {
        m[j] = 0;
        for (int l = 0; l <= j; l++) m[j] += row[l] / s->scaling[l] * s->Rinv[ant_at(ANT_DECISIONS, l) + j];
    }
    set_limit(s, id, m, 0, at.lower, at.upper);
    s->sense[id] = 0;
    s->row_of[s->rows++] = i;
    s->in[i] = 1;
}

/* Which limit DAQP's constraint `id` is. */
static int limit_of(const ant_solver *s, int id) {
    return id < ANT_DECISIONS ? id : ANT_DECISIONS + s->row_of[id - ANT_DECISIONS];
}

static void begin(const ant_qp *qp, ant_solver *s, DAQPWorkspace *w, DAQPSettings *options) {
    memset(w, 0, sizeof *w);
    invert(qp, s);
    for (int i = 0; i < ANT_DECISIONS; i++) {
        const ant_bound at = ant_bound_of(qp, i);
        set_limit(s, i, s->Rinv + ant_at(ANT_DECISIONS, i), i, at.lower, at.upper);
        s->sense[i] = 0;
    }
    s->rows = 0;
    memset(s->in, 0, sizeof s->in);
    w->n = w->ms = w->m = ANT_DECISIONS;
    w->M = s->M[0], w->dupper = s->dupper, w->dlower = s->dlower, w->Rinv = s->Rinv, w->v = s->v;
    w->sense = s->sense, w->scaling = s->scaling, w->x = s->x, w->u = s->u;
    w->lam = s->lam, w->lam_star = s->lam_star, w->L = s->L, w->D = s->D, w->xldl = s->xldl, w->zldl = s->zldl;
    w->WS = s->WS;
    w->settings = options;
    w->state = DAQP_STATE_RINV_NORMALIZED;
    reset_daqp_workspace(w);
}

/* By how much the active limits are missed at z. */
static void residuals(const ant_qp *qp, const ant_solver *s, const DAQPWorkspace *work,
                      const ant_real z[ANT_DECISIONS], ant_real missed[ANT_DECISIONS + 1]) {
    ant_real values[ANT_ROWS];
    ant_row_values(qp, z, values);
    for (int i = 0; i < work->n_active; i++) {
        const int id = work->WS[i], limit = limit_of(s, id);
        const ant_bound at = ant_bound_of(qp, limit);
        missed[i] = (limit < ANT_DECISIONS ? z[limit] : values[limit - ANT_DECISIONS]) -
                    (DAQP_IS_LOWER(id) ? at.lower : at.upper);
    }
}

/* The z at which the cost's gradient and the multipliers balance: R^T (R z + v) = -pushes, without the inverse of R. */
static void balance(const ant_qp *qp, const ant_real *multipliers, ant_real *z) {
    enum { n = ANT_MOVES };
    ant_real pushes[ANT_DECISIONS];
    memcpy(pushes, multipliers, sizeof pushes);
    for (int i = 0; i < ANT_ROWS; i++) {
        ant_real row[ANT_DECISIONS];
        if (multipliers[ANT_DECISIONS + i] == 0) continue;
        ant_row(qp, i, row);
        for (int j = 0; j < ANT_DECISIONS; j++) pushes[j] += multipliers[ANT_DECISIONS + i] * row[j];
    }
    for (int i = 0; i < n; i++) {
        const ant_real *Ri = qp->work.dense.R + ant_at(n, i);
        pushes[i] /= Ri[i];
        for (int j = i + 1; j < n; j++) pushes[j] -= Ri[j] * pushes[i];
    }
    for (int i = n - 1; i >= 0; i--) {
        const ant_real *Ri = qp->work.dense.R + ant_at(n, i);
        ant_real sum = qp->work.dense.v[i] + pushes[i];
        for (int j = i + 1; j < n; j++) sum += Ri[j] * z[j];
        z[i] = -sum / Ri[i];
    }
    const ant_real *price = qp->tuning->slack;
    for (int i = 0; i < 2; i++) z[n + i] = -(price[2 * i] + pushes[n + i]) / price[2 * i + 1];
}

/* DAQP's answer for the limits that it found active, its multipliers refined until these are met to the last digits. */
static void point(const ant_qp *qp, const ant_solver *s, DAQPWorkspace *work, ant_real *multipliers, ant_real *z) {
    ant_real missed[ANT_DECISIONS + 1];
    memset(multipliers, 0, ANT_LIMITS * sizeof multipliers[0]);
    memset(z, 0, ANT_DECISIONS * sizeof z[0]);
    for (int i = 0; i < work->n_active; i++)
        multipliers[limit_of(s, work->WS[i])] = work->lam_star[i] * work->scaling[work->WS[i]];
    balance(qp, multipliers, z);
    for (int round = 0; round < REFINEMENTS; round++) {
        ant_real change[ANT_DECISIONS] = {0};
        residuals(qp, s, work, z, missed);
        for (int i = 0; i < work->n_active; i++) work->xldl[i] = work->scaling[work->WS[i]] * missed[i];
        daqp_solve_working_set(work);
        for (int i = 0; i < work->n_active; i++)
            multipliers[limit_of(s, work->WS[i])] += work->scaling[work->WS[i]] * work->xldl[i];
        daqp_sub_working_set_rows(work, work->xldl, change);
        daqp_apply_Rinv(work, change);
        for (int i = 0; i < ANT_DECISIONS; i++) z[i] += change[i];
    }
    residuals(qp, s, work, z, missed);
    for (int i = 0; i < work->n_active; i++)
        if (work->WS[i] < ANT_DECISIONS) z[work->WS[i]] -= missed[i];
    work->reuse_ind = 0; /* DAQP's scratch was used */
}

/* Lets in the rows that z violates. Returns their number, or -1 if there is no room for them. */
static int widen(const ant_qp *qp, ant_solver *s, const ant_real z[ANT_DECISIONS]) {
    ant_real values[ANT_ROWS];
    const int before = s->rows;
    ant_row_values(qp, z, values);
    for (int i = 0; i < ANT_ROWS; i++)
        if (!s->in[i] && ant_breach(qp, i, values[i]) > ANT_LAZY) {
            if (s->rows == ANT_SLOTS) return -1;
            let_in(qp, s, i);
        }
    return s->rows - before;
}

ant_plan_status ant_persist(ant_controller *c, const ant_real u_last[2], int count, ant_real z[ANT_DECISIONS],
                            int *iterations) {
    (void)count;
    ant_solver *s = &c->qp.work.dense.work.solver;
    DAQPSettings options;
    DAQPWorkspace w;
    ant_real multipliers[ANT_LIMITS];
    if (!ant_condense(c, u_last)) return ANT_PLAN_NOT_FINITE;
    settings(&options, 0);
    begin(&c->qp, s, &w, &options);
    int wider;
    do {
        options.iter_limit = c->iteration_limit - *iterations;
        const int flag = daqp_ldp(&w);
        *iterations += w.iterations;
        if (flag <= 0) return ANT_PLAN_UNSOLVED;
        point(&c->qp, s, &w, multipliers, z);
        wider = widen(&c->qp, s, z);
        w.m = ANT_DECISIONS + s->rows;
        if (wider < 0) return ANT_PLAN_UNSOLVED;
    } while (wider > 0);
    for (int i = 0; i < ANT_MOVES; i++) c->qp.guess[i] = (signed char)((multipliers[i] > 0) - (multipliers[i] < 0));
    return ant_certified(&c->qp, z, multipliers) ? ANT_PLAN_OPTIMAL : ANT_PLAN_REFUSED;
}
