/* A target: the usual one, whether one makes sense, and the answer to one that does not. */
#include "target.h"

#include "mechanism.h"
#include "real.h"

ant_target ant_target_of(const ant_real q[ANT_JOINTS], const ant_real T[ANT_JOINTS]) {
    ant_target t;
    for (int i = 0; i < ANT_JOINTS; i++) {
        t.q[i] = q[i];
        t.T[i] = T[i];
    }
    for (int i = 0; i < ANT_STIFFNESSES; i++) t.K[i] = ANT_NAN;
    for (int j = 0; j < ANT_MUSCLES; j++) t.P_now[j] = 0;
    t.min_force = 0;
    t.max_force = ANT_INFINITY;
    t.max_step = ANT_INFINITY;
    t.nearest = 0;
    t.follow = 0;
    t.priority = ANT_TORQUE_FIRST;
    return t;
}

/* The entry of a triangle at row i and column j. */
static ant_real entry(const ant_real *triangle, int i, int j) {
    const int row = i < j ? i : j, column = i < j ? j : i;
    return triangle[row * ANT_JOINTS - row * (row - 1) / 2 + column - row];
}

/* Whether a stiffness is positive definite, by the pivots of its elimination. */
int ant_positive_definite(const ant_real *K) {
    ant_real left[ANT_JOINTS][ANT_JOINTS], greatest = 0;
    for (int i = 0; i < ANT_JOINTS; i++) {
        for (int j = 0; j < ANT_JOINTS; j++) {
            left[i][j] = entry(K, i, j);
            if (ant_abs(left[i][j]) > greatest) greatest = ant_abs(left[i][j]);
        }
    }
    for (int k = 0; k < ANT_JOINTS; k++) {
        if (!(left[k][k] > ANT_MET * greatest)) return 0;
        for (int i = k + 1; i < ANT_JOINTS; i++) {
            const ant_real factor = left[i][k] / left[k][k];
            for (int j = k + 1; j < ANT_JOINTS; j++) left[i][j] -= factor * left[k][j];
        }
    }
    return 1;
}

int ant_sensible(const ant_target *t) {
    int numbers = 1, whole = 1;
    for (int i = 0; i < ANT_JOINTS; i++) {
        numbers = numbers && isfinite(t->T[i]) && ant_abs(t->q[i]) <= 2 * ANT_PI;
        numbers = numbers && !(entry(t->K, i, i) <= 0);
    }
    for (int i = 0; i < ANT_STIFFNESSES; i++) {
        numbers = numbers && !isinf(t->K[i]);
        whole = whole && !isnan(t->K[i]);
    }
    for (int j = 0; j < ANT_MUSCLES; j++) numbers = numbers && isfinite(t->P_now[j]);
    const int forces = (t->min_force >= 0 || (isinf(t->min_force) && t->min_force < 0)) && t->max_force > 0 &&
                       t->max_force > t->min_force;
    const int known = t->priority == ANT_TORQUE_FIRST || t->priority == ANT_STIFFNESS_FIRST;
    return numbers && forces && t->max_step > 0 && known && (!whole || ant_positive_definite(t->K));
}

/* The present pressures, as far as they are valid: the answer to an invalid target. */
void ant_refuse(const ant_target *t, ant_allocation *a) {
    for (int j = 0; j < ANT_MUSCLES; j++) a->P[j] = ant_clip(t->P_now[j], ANT_SUPPLY_LO, ANT_HI[j]);
    for (int i = 0; i < ANT_JOINTS; i++) a->T[i] = 0;
    for (int i = 0; i < ANT_STIFFNESSES; i++) a->K[i] = 0;
    a->residual = ANT_INFINITY;
    a->status = ANT_BAD_INPUT;
    a->rounds = 0;
}
