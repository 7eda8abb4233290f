/* A step that always has an answer, found in another way than the QP's:
 *
 *     minimise   cost without rows + sum of charge_i max(0, breach_i)^2/2     over    lower <= v <= upper
 *
 * Of the limits only the slew is hard. An active set of bounds, each charging the rows that the last one broke, until
 * they repeat; the minimum with the bounds held is a Newton step of the recursions. The result is the best point met:
 * it is allowed, and better than to go on with v = 0. */
#include <string.h>

#include "control.h"
#include "tables.h"

enum { N = ANT_HORIZON, CHANGES = 4 * ANT_MOVES, SUPPLY = 4, RANGE = 8, FORCES = 10, ALL = 12 }; /* rows, see rows.py */

static const ant_real HELD = ANT_R(1e20); /* curvature of a held command */

typedef struct {
    ant_structured q;
    unsigned char charged[N][ALL], was[N][ALL];
    signed char side[N][2]; /* -1, 1: held at its lower, upper bound */
} softened;

static ant_real charge_of(const softened *s, int row) {
    return row < RANGE ? ANT_CHARGE : s->q.setting.slack[row < FORCES ? 1 : 3];
}

static ant_real breach(const softened *s, int k, int row) {
    return s->q.work.rows.residual[k][row] - s->q.work.rows.b[k][row];
}

/* Gradient, rows and their charges at the point. */
static void differentiate(const softened *s) {
    const ant_qp_work *w = &s->q.work;
    ant_gradients(&s->q.path, &s->q.errors, &s->q.setting.cost, &s->q.at, w->gx, w->gv);
    ant_values(&s->q.path, &s->q.at, ALL, w->rows.residual);
    for (int k = 0; k < N; k++)
        for (int row = 0; row < ALL; row++)
            w->rows.push[k][row] = s->charged[k][row] ? charge_of(s, row) * breach(s, k, row) : 0;
    w->rows.push[N][0] = w->rows.push[N][1] = 0;
}

/* At the point, above the origin's but for its rows; after differentiate. */
static ant_real cost(const softened *s) {
    const ant_qp_work *w = &s->q.work;
    ant_real sum = 0;
    ant_adjoint(&s->q.path, w->gx, w->gv, w->r);
    for (int k = 0; k < N; k++) {
        for (int i = 0; i < 2; i++) sum += (w->first[k][i] + w->r[k][i]) / 2 * s->q.at.v[k][i];
        for (int row = SUPPLY; row < ALL; row++) {
            const ant_real beyond = breach(s, k, row);
            if (beyond > 0) sum += charge_of(s, row) / 2 * beyond * beyond;
        }
    }
    return sum;
}

/* The step to the minimum with the changes on a side held. */
static void step(const softened *s) {
    const ant_qp_work *w = &s->q.work;
    for (int k = 0; k < N; k++)
        for (int row = 0; row < ALL; row++)
            w->rows.W[k][row] = row < 2 && s->side[k][row] != 0 ? HELD : s->charged[k][row] ? charge_of(s, row) : 0;
    w->rows.W[N][0] = w->rows.W[N][1] = HELD; /* no slacks */
    ant_factorise(&s->q.path, &s->q.setting.cost, s->q.setting.slack, w->rows.W, s->q.bounded.there, ALL, &w->factors);
    ant_direction(&s->q.path, &w->factors, s->q.setting.slack, &s->q.at, w->gx, w->gv, w->rows.push, ALL, &w->by);
}

/* By the step, up to the first bound met, where that change is held; whether one was. */
static int go(softened *s) {
    ant_real(*v)[2] = s->q.at.v;
    ant_real(*by)[2] = s->q.work.by.v;
    ant_real share = 1;
    int met = -1;
    for (int j = 0; j < 2 * N; j++) {
        const int k = j / 2, i = j % 2;
        const ant_real target = v[k][i] + by[k][i];
        const ant_real bound = ant_clip(target, s->q.bounded.lower[k][i], s->q.bounded.upper[k][i]);
        if (s->side[k][i] != 0 || bound == target) continue;
        if (met < 0 || (bound - v[k][i]) / by[k][i] < share) {
            share = (bound - v[k][i]) / by[k][i];
            met = j;
        }
    }
    for (int j = 0; j < 2 * N; j++)
        if (s->side[j / 2][j % 2] == 0) v[j / 2][j % 2] += share * by[j / 2][j % 2];
    if (met >= 0) {
        const int k = met / 2, i = met % 2;
        s->side[k][i] = by[k][i] < 0 ? -1 : 1;
        v[k][i] = by[k][i] < 0 ? s->q.bounded.lower[k][i] : s->q.bounded.upper[k][i];
    }
    ant_brought_within(&s->q.path, &s->q.bounded, &s->q.at);
    return met >= 0;
}

/* Lets go of the change that most wants to leave its bound; whether one does. */
static int release(softened *s) {
    const ant_qp_work *w = &s->q.work;
    ant_real most = 0;
    signed char *which = NULL;
    ant_left_over(&s->q.path, s->q.setting.slack, &s->q.at, w->gx, w->gv, w->rows.push, ALL, w->r);
    for (int k = 0; k < N; k++)
        for (int i = 0; i < 2; i++)
            if (s->side[k][i] * w->r[k][i] > most) {
                most = s->side[k][i] * w->r[k][i];
                which = &s->side[k][i];
            }
    if (which != NULL) *which = 0;
    return which != NULL;
}

static void to_origin(const softened *s) {
    memset(s->q.at.v, 0, N * sizeof s->q.at.v[0]);
    memset(s->q.at.xi, 0, (N + 1) * sizeof s->q.at.xi[0]);
}

/* The minimum within the bounds, from v = 0. */
static void minimise(softened *s) {
    memset(s->side, 0, sizeof s->side);
    to_origin(s);
    differentiate(s);
    for (int change = 0; change < CHANGES; change++) {
        step(s);
        const int met = go(s);
        differentiate(s);
        if (!met && !release(s)) return;
    }
}

int ant_soften(ant_controller *c, const ant_real u_last[2], ant_real best[ANT_DECISIONS]) {
    softened s = {ant_structured_of(&c->qp), {{0}}, {{0}}, {{0}}};
    int found = 0;
    ant_deviate(c, &s.q, u_last);
    ant_sides(&s.q.path, s.q.u, &s.q.setting.bounds, &s.q.bounded, s.q.work.rows.b);
    to_origin(&s);
    differentiate(&s);
    ant_adjoint(&s.q.path, s.q.work.gx, s.q.work.gv, s.q.work.first);
    ant_real least = cost(&s);
    for (int round = 0; round < ANT_ROUNDS; round++) {
        minimise(&s);
        const ant_real price = cost(&s);
        if (price < least) {
            least = price;
            ant_decisions(&c->qp, best);
            found = 1;
        }
        memcpy(s.was, s.charged, sizeof s.was);
        for (int k = 0; k < N; k++)
            for (int row = SUPPLY; row < ALL; row++) s.charged[k][row] = breach(&s, k, row) > 0;
        if (memcmp(s.was, s.charged, sizeof s.was) == 0) break;
    }
    return found;
}
