/* The limits that are no bounds on a decision: commands within the supply; theta - s at most its upper, theta + s at
 * least its lower limit; both forces + s_F at least their own. */
#include <string.h>

#include "dense.h"
#include "tables.h"

enum { N = ANT_HORIZON, THETA = ANT_MOVES, FORCE = ANT_MOVES + 1 }; /* the slacks s and s_F */
enum { COMMANDS = 2 * N, UPPER = COMMANDS + N, LOWER = UPPER + N }; /* one behind the last of each kind */

void ant_row(const ant_qp *qp, int i, ant_real row[ANT_DECISIONS]) {
    memset(row, 0, ANT_DECISIONS * sizeof row[0]);
    if (i < COMMANDS) {
        for (int j = i % 2; j < 2 * ANT_ACTING[i / 2]; j += 2) row[j] = 1;
    } else if (i < LOWER) {
        const int k = i < UPPER ? i - COMMANDS : i - UPPER;
        memcpy(row, qp->work.dense.G[k][0], sizeof qp->work.dense.G[k][0]);
        row[THETA] = i < UPPER ? -1 : 1;
    } else {
        const int k = (i - LOWER) / 2;
        const ant_real *slope = qp->slope[k + 1][1 + (i - LOWER) % 2];
        for (int j = 0; j < ANT_MOVES; j++)
            for (int l = 0; l < 4; l++) row[j] += slope[l] * qp->work.dense.G[k][l][j];
        row[FORCE] = 1;
    }
}

/* Pressures that start outside the supply come back no faster than the slew limit: up to there z = 0 is allowed. */
static void row_bounds(const ant_qp *qp, int i, ant_real *lower, ant_real *upper) {
    const ant_motion *m = &qp->motion;
    *lower = -ANT_INFINITY;
    *upper = ANT_INFINITY;
    if (i < COMMANDS) {
        const ant_real u = m->u[i / 2][i % 2];
        *lower = u > ANT_SUPPLY_LO ? (ANT_SUPPLY_LO - u) / ANT_BAR : 0;
        *upper = u < ANT_SUPPLY_HI ? (ANT_SUPPLY_HI - u) / ANT_BAR : 0;
    } else if (i < UPPER) {
        *upper = ANT_RIGHT - m->x[i - COMMANDS + 1][0];
    } else if (i < LOWER) {
        *lower = ANT_LEFT - m->x[i - UPPER + 1][0];
    } else {
        *lower = ANT_MIN_FORCE - m->F[(i - LOWER) / 2 + 1][(i - LOWER) % 2];
    }
}

static void bounds(const ant_qp *qp, int decision, ant_real *lower, ant_real *upper) {
    *lower = decision < ANT_MOVES ? qp->work.dense.lower[decision] : 0;
    *upper = decision < ANT_MOVES ? qp->work.dense.upper[decision] : ANT_INFINITY;
}

ant_valued_row ant_row_at(const ant_qp *qp, int limit, const ant_real z[ANT_DECISIONS]) {
    ant_valued_row at = {0};
    if (limit < ANT_DECISIONS) {
        at.row[limit] = 1;
        bounds(qp, limit, &at.lower, &at.upper);
    } else {
        ant_row(qp, limit - ANT_DECISIONS, at.row);
        row_bounds(qp, limit - ANT_DECISIONS, &at.lower, &at.upper);
    }
    for (int j = 0; j < ANT_DECISIONS; j++) {
        at.value += at.row[j] * z[j];
        at.size += ant_abs(at.row[j] * z[j]);
    }
    return at;
}

ant_real ant_breach(const ant_qp *qp, int i, const ant_real z[ANT_DECISIONS]) {
    const ant_valued_row at = ant_row_at(qp, ANT_DECISIONS + i, z);
    const ant_real below = at.lower - at.value, above = at.value - at.upper;
    return below > above ? below : above;
}
