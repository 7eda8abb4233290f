/* A solver's word is not taken. Multipliers (positive at an upper, negative at a lower limit) prove how good a z is:
 * with the gradient of the Lagrangian r = H z + f + multipliers_z + A^T multipliers_A its cost exceeds the least by at
 * most
 *
 *     gap = r^T H^-1 r/2 + sum of multiplier_i (limit_i - value_i),      H = R^T R. */
#include "control.h"

static const ant_real PRIMAL =
    ANT_R(1e-4);                         /* [bar], [rad], [N] by which a limit may be broken; what is sent is clipped */
static const ant_real GAP = ANT_R(1e-3); /* of the cost that the moves gain */

/* The greatest violation, and the second part of the gap; adds A^T multipliers to `pushes`. */
static ant_real walk(const ant_qp *qp, const ant_real *z, const ant_real *multipliers, ant_real *pushes,
                     ant_real *gap) {
    ant_real worst = 0;
    for (int id = 0; id < ANT_LIMITS; id++) {
        ant_real row[ANT_DECISIONS], lower = 0, upper = ANT_INFINITY, value = 0;
        const ant_real push = multipliers[id];
        if (id < ANT_DECISIONS) {
            value = z[id];
            if (id < ANT_MOVES) lower = qp->lower[id], upper = qp->upper[id];
        } else {
            ant_row(qp, id - ANT_DECISIONS, row);
            ant_row_bounds(qp, id - ANT_DECISIONS, &lower, &upper);
            for (int j = 0; j < ANT_DECISIONS; j++) value += row[j] * z[j];
        }
        if (!(lower - value <= worst)) worst = lower - value;
        if (!(value - upper <= worst)) worst = value - upper;
        const ant_real limit = push > 0 ? upper : lower;
        if (push == 0 || !isfinite(limit)) continue; /* there is nothing to push against at infinity */
        *gap += push * (limit - value);
        if (id < ANT_DECISIONS)
            pushes[id] += push;
        else
            for (int j = 0; j < ANT_DECISIONS; j++) pushes[j] += push * row[j];
    }
    return worst;
}

/* |R^-T r|^2/2 = |R z + v + R^-T pushes|^2/2, slacks included. */
static ant_real stationarity(const ant_qp *qp, const ant_real *z, ant_real *pushes) {
    ant_real square = 0;
    for (int i = 0; i < ANT_MOVES; i++) { /* forward substitution in place */
        const ant_real *Ri = qp->R + ant_at(ANT_MOVES, i);
        ant_real residual = qp->v[i];
        pushes[i] /= Ri[i];
        for (int j = i + 1; j < ANT_MOVES; j++) pushes[j] -= Ri[j] * pushes[i];
        for (int j = i; j < ANT_MOVES; j++) residual += Ri[j] * z[j];
        square += (residual + pushes[i]) * (residual + pushes[i]);
    }
    const ant_real s = ANT_ROOT_SLACK * z[ANT_MOVES] + (ANT_SLACK + pushes[ANT_MOVES]) / ANT_ROOT_SLACK;
    const ant_real s_F =
        ANT_ROOT_SLACK_FORCE * z[ANT_MOVES + 1] + (ANT_SLACK_FORCE + pushes[ANT_MOVES + 1]) / ANT_ROOT_SLACK_FORCE;
    return (square + s * s + s_F * s_F) / 2;
}

int ant_certified(const ant_qp *qp, const ant_real z[ANT_DECISIONS], const ant_real multipliers[ANT_LIMITS]) {
    ant_real pushes[ANT_DECISIONS] = {0}, gap = 0;
    const ant_real violation = walk(qp, z, multipliers, pushes, &gap);
    gap += stationarity(qp, z, pushes);
    const ant_real gain = ant_abs(ant_cost(ANT_MOVES, qp->R, qp->v, z));
    return violation <= PRIMAL && ant_abs(gap) <= GAP * (gain > 1 ? gain : 1);
}
