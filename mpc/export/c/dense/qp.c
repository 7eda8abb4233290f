/* The QP of a step,
 *
 *     minimise   |R z + v|^2/2 + price of the slacks    over the moves and the slacks s, s_F >= 0
 *     subject to lower <= z <= upper and the rows of rows.c,
 *
 * by DAQP (D. Arnstrom, src/daqp), a dual active-set method that finds the exact solution in a finite number of
 * iterations, every one a rank-one update. DAQP takes the problem as the least distance |u|, u = R z + v. Rows seldom
 * bind: each is left out until a solution breaks it, from where the method goes on. */
#include <string.h>

#include "dense.h"
#include "daqp_core.h"

static const ant_real FAR = ANT_R(1e30); /* DAQP's infinity */
enum { REFINEMENTS = 3 };

static void settings(DAQPSettings *s, int iteration_limit) {
    const int single = sizeof(ant_real) == sizeof(float);
    memset(s, 0, sizeof *s);
    s->primal_tol = single ? ANT_R(2e-6) : DAQP_DEFAULT_PRIM_TOL;
    s->dual_tol = single ? ANT_R(1e-6) : DAQP_DEFAULT_DUAL_TOL;
    s->zero_tol = single ? ANT_R(1e-7) : DAQP_DEFAULT_ZERO_TOL;
    s->pivot_tol = single ? ANT_R(1e-4) : DAQP_DEFAULT_PIVOT_TOL;
    s->progress_tol = single ? ANT_R(1e-6) : DAQP_DEFAULT_PROG_TOL;
    s->sing_tol = single ? ANT_R(1e-6) : DAQP_DEFAULT_SING_TOL;
    s->refactor_tol = single ? ANT_R(1e-5) : DAQP_DEFAULT_REFACTOR_TOL;
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
    s->Rinv[ant_at(n, moves) + moves] = 1 / ANT_ROOT_SLACK;
    s->Rinv[ant_at(n, moves + 1) + moves + 1] = 1 / ANT_ROOT_SLACK_FORCE;
    s->v[moves] = ANT_SLACK / ANT_ROOT_SLACK;
    s->v[moves + 1] = ANT_SLACK_FORCE / ANT_ROOT_SLACK_FORCE;
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

/* Row i joins: its m is the row times R^-1, whose rows have been scaled. */
static void let_in(const ant_qp *qp, ant_solver *s, int i) {
    const ant_real none[ANT_DECISIONS] = {0};
    const ant_valued_row at = ant_row_at(qp, ANT_DECISIONS + i, none);
    for (int j = 0; j < ANT_DECISIONS; j++) {
        s->M[i][j] = 0;
        for (int l = 0; l <= j; l++) s->M[i][j] += at.row[l] / s->scaling[l] * s->Rinv[ant_at(ANT_DECISIONS, l) + j];
    }
    set_limit(s, ANT_DECISIONS + i, s->M[i], 0, at.lower, at.upper);
    s->sense[ANT_DECISIONS + i] = 0;
}

static void begin(const ant_qp *qp, ant_solver *s, DAQPWorkspace *w, DAQPSettings *options) {
    memset(w, 0, sizeof *w);
    invert(qp, s);
    for (int i = 0; i < ANT_DECISIONS; i++) {
        const int move = i < ANT_MOVES;
        set_limit(s, i, s->Rinv + ant_at(ANT_DECISIONS, i), i, move ? qp->work.dense.lower[i] : 0,
                  move ? qp->work.dense.upper[i] : ANT_INFINITY);
        s->sense[i] = 0;
    }
    for (int i = ANT_DECISIONS; i < ANT_LIMITS; i++) s->sense[i] = DAQP_IMMUTABLE; /* not looked at */
    w->n = w->ms = ANT_DECISIONS;
    w->m = ANT_LIMITS;
    w->M = s->M[0], w->dupper = s->dupper, w->dlower = s->dlower, w->Rinv = s->Rinv, w->v = s->v;
    w->sense = s->sense, w->scaling = s->scaling, w->x = s->x, w->u = s->u;
    w->lam = s->lam, w->lam_star = s->lam_star, w->L = s->L, w->D = s->D, w->xldl = s->xldl, w->zldl = s->zldl;
    w->WS = s->WS;
    w->settings = options;
    w->state = DAQP_STATE_RINV_NORMALIZED;
    reset_daqp_workspace(w);
}

/* By how much active limit `id` is missed at z. */
static ant_real residual(const ant_qp *qp, const DAQPWorkspace *work, int id, const ant_real z[ANT_DECISIONS]) {
    const ant_valued_row at = ant_row_at(qp, id, z);
    return at.value - (DAQP_IS_LOWER(id) ? at.lower : at.upper);
}

/* The z at which the cost's gradient and the multipliers balance: R^T (R z + v) = -pushes, without the inverse of R. */
static void balance(const ant_qp *qp, const DAQPWorkspace *work, const ant_real *multipliers, ant_real *z) {
    enum { n = ANT_MOVES };
    ant_real pushes[ANT_DECISIONS] = {0};
    for (int i = 0; i < work->n_active; i++) {
        const ant_valued_row at = ant_row_at(qp, work->WS[i], z);
        for (int j = 0; j < ANT_DECISIONS; j++) pushes[j] += multipliers[work->WS[i]] * at.row[j];
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
    z[n] = -(ANT_SLACK + pushes[n]) / ANT_SLACK_SQUARE;
    z[n + 1] = -(ANT_SLACK_FORCE + pushes[n + 1]) / ANT_SLACK_FORCE_SQUARE;
}

/* DAQP's answer for the limits that it found active, its multipliers refined until these are met to the last digits. */
static void point(const ant_qp *qp, DAQPWorkspace *work, ant_real *multipliers, ant_real *z) {
    memset(multipliers, 0, ANT_LIMITS * sizeof multipliers[0]);
    memset(z, 0, ANT_DECISIONS * sizeof z[0]);
    for (int i = 0; i < work->n_active; i++) multipliers[work->WS[i]] = work->lam_star[i] * work->scaling[work->WS[i]];
    balance(qp, work, multipliers, z);
    for (int round = 0; round < REFINEMENTS; round++) {
        ant_real change[ANT_DECISIONS] = {0};
        for (int i = 0; i < work->n_active; i++)
            work->xldl[i] = work->scaling[work->WS[i]] * residual(qp, work, work->WS[i], z);
        daqp_solve_working_set(work);
        for (int i = 0; i < work->n_active; i++) multipliers[work->WS[i]] += work->scaling[work->WS[i]] * work->xldl[i];
        daqp_sub_working_set_rows(work, work->xldl, change);
        daqp_apply_Rinv(work, change);
        for (int i = 0; i < ANT_DECISIONS; i++) z[i] += change[i];
    }
    for (int i = 0; i < work->n_active; i++)
        if (work->WS[i] < ANT_DECISIONS) z[work->WS[i]] -= residual(qp, work, work->WS[i], z);
    work->reuse_ind = 0; /* DAQP's scratch was used */
}

/* Lets in the rows that z breaks; whether there are any. */
static int widen(const ant_qp *qp, ant_solver *s, const ant_real z[ANT_DECISIONS]) {
    int any = 0;
    for (int i = 0; i < ANT_ROWS; i++)
        if (s->sense[ANT_DECISIONS + i] == DAQP_IMMUTABLE && ant_breach(qp, i, z) > ANT_LAZY) {
            let_in(qp, s, i);
            any = 1;
        }
    return any;
}

ant_plan_status ant_persist(ant_controller *c, const ant_real u_last[2], int count, ant_real z[ANT_DECISIONS],
                            int *iterations) {
    (void)count;
    ant_solver *s = &c->qp.work.dense.solver;
    DAQPSettings options;
    DAQPWorkspace w;
    ant_real multipliers[ANT_LIMITS];
    if (!ant_condense(c, u_last)) return ANT_PLAN_NOT_FINITE;
    settings(&options, 0);
    begin(&c->qp, s, &w, &options);
    do {
        options.iter_limit = c->iteration_limit - *iterations;
        const int flag = daqp_ldp(&w);
        *iterations += w.iterations;
        if (flag <= 0) return ANT_PLAN_UNSOLVED;
        point(&c->qp, &w, multipliers, z);
    } while (widen(&c->qp, s, z));
    for (int i = 0; i < ANT_MOVES; i++) c->qp.guess[i] = (signed char)((multipliers[i] > 0) - (multipliers[i] < 0));
    return ant_certified(&c->qp, z, multipliers) ? ANT_PLAN_OPTIMAL : ANT_PLAN_REFUSED;
}
