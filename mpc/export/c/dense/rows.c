/* The limits that are no bounds on a decision: commands within the supply; theta - s at most its upper, theta + s at
 * least its lower limit; both forces + s_F at least their own. */
#include <string.h>

#include "dense.h"
#include "tables.h"

enum { N = ANT_HORIZON, THETA = ANT_MOVES, FORCE = ANT_MOVES + 1 }; /* the slacks s and s_F */
enum { COMMANDS = 2 * N, UPPER = COMMANDS + N, LOWER = UPPER + N }; /* one behind the last of each kind */

/* Derivative of slope dx_{k+1} by the moves: backwards from there to the sample where each begins. */
static void through(const ant_qp *qp, int k, const ant_real slope[4], ant_real row[ANT_DECISIONS]) {
    ant_real p[4], w[2] = {0, 0};
    memcpy(p, slope, sizeof p);
    for (int b = ANT_ACTING[k] - 1; k >= 0; k--) {
        ant_real before[4] = {0};
        for (int i = 0; i < 4; i++) {
            for (int j = 0; j < 2; j++) w[j] += p[i] * qp->B[k][i][j];
            for (int j = 0; j < 4; j++) before[j] += p[i] * qp->A[k][i][j];
        }
        memcpy(p, before, sizeof p);
        if (ANT_STARTS[b] == k) memcpy(row + 2 * b--, w, sizeof w);
    }
}

void ant_row(const ant_qp *qp, int i, ant_real row[ANT_DECISIONS]) {
    memset(row, 0, ANT_DECISIONS * sizeof row[0]);
    if (i < COMMANDS) {
        for (int j = i % 2; j < 2 * ANT_ACTING[i / 2]; j += 2) row[j] = 1;
    } else if (i < LOWER) {
        const ant_real angle[4] = {1, 0, 0, 0};
        through(qp, i < UPPER ? i - COMMANDS : i - UPPER, angle, row);
        row[THETA] = i < UPPER ? -1 : 1;
    } else {
        const int k = (i - LOWER) / 2;
        through(qp, k, qp->slope[k + 1][1 + (i - LOWER) % 2], row);
        row[FORCE] = 1;
    }
}

void ant_row_values(const ant_qp *qp, const ant_real z[ANT_DECISIONS], ant_real value[ANT_ROWS]) {
    ant_real x[4] = {0}, w[2] = {0, 0};
    for (int k = 0, b = 0; k < N; k++) {
        ant_real next[4];
        if (b < ANT_BLOCKS && ANT_STARTS[b] == k) {
            for (int i = 0; i < 2; i++) w[i] += z[2 * b + i];
            b++;
        }
        for (int i = 0; i < 4; i++) {
            next[i] = qp->B[k][i][0] * w[0] + qp->B[k][i][1] * w[1];
            for (int j = 0; j < 4; j++) next[i] += qp->A[k][i][j] * x[j];
        }
        memcpy(x, next, sizeof x);
        value[COMMANDS + k] = x[0] - z[THETA];
        value[UPPER + k] = x[0] + z[THETA];
        for (int i = 0; i < 2; i++) {
            const ant_real *slope = qp->slope[k + 1][1 + i];
            value[2 * k + i] = w[i];
            value[LOWER + 2 * k + i] = z[FORCE];
            for (int j = 0; j < 4; j++) value[LOWER + 2 * k + i] += slope[j] * x[j];
        }
    }
}

/* Pressures that start outside the supply come back no faster than the slew limit: up to there z = 0 is allowed. */
static ant_bound row_bounds(const ant_qp *qp, int i) {
    const ant_motion *m = &qp->motion;
    ant_bound at = {-ANT_INFINITY, ANT_INFINITY};
    if (i < COMMANDS) {
        const ant_real u = m->u[i / 2][i % 2];
        at.lower = u > ANT_SUPPLY_LO ? (ANT_SUPPLY_LO - u) / ANT_BAR : 0;
        at.upper = u < ANT_SUPPLY_HI ? (ANT_SUPPLY_HI - u) / ANT_BAR : 0;
    } else if (i < UPPER) {
        at.upper = ANT_RIGHT - m->x[i - COMMANDS + 1][0];
    } else if (i < LOWER) {
        at.lower = ANT_LEFT - m->x[i - UPPER + 1][0];
    } else {
        at.lower = qp->tuning->min_force - m->F[(i - LOWER) / 2 + 1][(i - LOWER) % 2];
    }
    return at;
}

ant_bound ant_bound_of(const ant_qp *qp, int limit) {
    if (limit >= ANT_DECISIONS) return row_bounds(qp, limit - ANT_DECISIONS);
    const int move = limit < ANT_MOVES;
    return (ant_bound){move ? qp->work.dense.lower[limit] : 0, move ? qp->work.dense.upper[limit] : ANT_INFINITY};
}

ant_real ant_breach(const ant_qp *qp, int i, ant_real value) {
    const ant_bound at = row_bounds(qp, i);
    return at.lower - value > value - at.upper ? at.lower - value : value - at.upper;
}
