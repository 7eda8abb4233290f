/* Certificate of an answer z from multipliers (positive at an upper, negative at a lower limit), which does not rely on
 * the solver's status: with the gradient of the Lagrangian r = H z + f + multipliers_z + A^T multipliers_A its cost
 * exceeds the least by at most
 *
 *     gap = r^T H^-1 r/2 + sum of |multiplier_i (limit_i - value_i)|,      H = R^T R,
 *
 * which has to be small against the gain of the moves: single precision cannot resolve less.
 *
 * A violation in the last digits of a limit is not counted, since the slacks' prices would amplify it. */
#include <float.h>

#include "dense.h"

static const ant_real LAST_DIGITS = 8 * FLT_EPSILON;

typedef struct {
    ant_real pushes[ANT_DECISIONS]; /* multipliers_z + A^T multipliers_A */
    ant_real gap;
    ant_real rounding; /* error of the gap by rounding */
    ant_real violation;
} account;

static void add(account *a, const ant_qp *qp, const ant_real *z, int limit, ant_real value, ant_real push) {
    const ant_bound at = ant_bound_of(qp, limit);
    ant_real row[ANT_DECISIONS] = {0}, size = 0; /* of the summands of the value */
    if (!(at.lower - value <= a->violation)) a->violation = at.lower - value;
    if (!(value - at.upper <= a->violation)) a->violation = value - at.upper;
    const ant_real bound = push > 0 ? at.upper : at.lower;
    if (push == 0 || !isfinite(bound)) return; /* no bound, no push */
    if (limit < ANT_DECISIONS)
        row[limit] = 1;
    else
        ant_row(qp, limit - ANT_DECISIONS, row);
    for (int j = 0; j < ANT_DECISIONS; j++) {
        size += ant_abs(row[j] * z[j]);
        a->pushes[j] += push * row[j];
    }
    a->gap += ant_abs(push * (bound - value));
    a->rounding += LAST_DIGITS * ant_abs(push) * (ant_abs(bound) + size);
}

/* |R^-T r|^2/2 = |R z + v + R^-T pushes|^2/2, slacks included. */
static ant_real stationarity(const ant_qp *qp, const ant_real *z, ant_real *pushes) {
    ant_real square = 0;
    for (int i = 0; i < ANT_MOVES; i++) { /* forward substitution in place */
        const ant_real *Ri = qp->work.dense.R + ant_at(ANT_MOVES, i);
        ant_real residual = qp->work.dense.v[i];
        pushes[i] /= Ri[i];
        for (int j = i + 1; j < ANT_MOVES; j++) pushes[j] -= Ri[j] * pushes[i];
        for (int j = i; j < ANT_MOVES; j++) residual += Ri[j] * z[j];
        square += (residual + pushes[i]) * (residual + pushes[i]);
    }
    for (int i = 0; i < 2; i++) {
        const ant_real *price = qp->tuning->slack + 2 * i, root = ANT_F(sqrt)(price[1]);
        const ant_real s = root * z[ANT_MOVES + i] + (price[0] + pushes[ANT_MOVES + i]) / root;
        square += s * s;
    }
    return square / 2;
}

int ant_certified(const ant_qp *qp, const ant_real z[ANT_DECISIONS], const ant_real multipliers[ANT_LIMITS]) {
    account a = {0};
    ant_real values[ANT_ROWS];
    ant_row_values(qp, z, values);
    for (int limit = 0; limit < ANT_LIMITS; limit++)
        add(&a, qp, z, limit, limit < ANT_DECISIONS ? z[limit] : values[limit - ANT_DECISIONS], multipliers[limit]);
    a.gap += stationarity(qp, z, a.pushes);
    const ant_real gain = ant_abs(ant_cost(ANT_MOVES, qp->work.dense.R, qp->work.dense.v, z));
    return a.violation <= ANT_PRIMAL && a.gap <= ANT_GAP * (gain > 1 ? gain : 1) + a.rounding;
}
