/* The limits that are no bounds on a decision: commands within the supply; theta - s at most its upper, theta + s at
 * least its lower limit; both forces + s_F at least their own. */
#include <string.h>

#include "control.h"
#include "tables.h"

enum { N = ANT_HORIZON, THETA = ANT_MOVES, FORCE = ANT_MOVES + 1 }; /* the slacks s and s_F */
enum { COMMANDS = 2 * N, UPPER = COMMANDS + N, LOWER = UPPER + N }; /* one behind the last of each kind */

void ant_row(const ant_qp *qp, int i, ant_real row[ANT_DECISIONS]) {
    memset(row, 0, ANT_DECISIONS * sizeof row[0]);
    if (i < COMMANDS) {
        for (int j = i % 2; j < 2 * ANT_ACTING[i / 2]; j += 2) row[j] = 1;
    } else if (i < LOWER) {
        const int k = i < UPPER ? i - COMMANDS : i - UPPER;
        memcpy(row, qp->G[k][0], sizeof qp->G[k][0]);
        row[THETA] = i < UPPER ? -1 : 1;
    } else {
        memcpy(row, qp->GF[(i - LOWER) / 2][(i - LOWER) % 2], sizeof qp->GF[0][0]);
        row[FORCE] = 1;
    }
}

/* Pressures that start outside the supply come back no faster than the slew limit: up to there z = 0 is allowed. */
void ant_row_bounds(const ant_qp *qp, int i, ant_real *lower, ant_real *upper) {
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

ant_real ant_breach(const ant_qp *qp, int i, const ant_real z[ANT_DECISIONS]) {
    ant_real row[ANT_DECISIONS], lower, upper, value = 0;
    ant_row(qp, i, row);
    ant_row_bounds(qp, i, &lower, &upper);
    for (int j = 0; j < ANT_DECISIONS; j++) value += row[j] * z[j];
    return lower - value > value - upper ? lower - value : value - upper;
}

ant_real ant_charge(int i) { return i < COMMANDS ? ANT_CHARGE : i < LOWER ? ANT_SLACK_SQUARE : ANT_SLACK_FORCE_SQUARE; }
