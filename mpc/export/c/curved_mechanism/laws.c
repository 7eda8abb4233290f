/* What muscles and their routes give at a posture; the problem in these terms, y = C (F_1, k_1, ..., F_m, k_m). */
#include "curved.h"
#include "mechanism.h"
#include "real.h"

enum { ROOT_STEPS = 80, LOOKED_AT = 32, CLOSER = 4 }; /* of Newton and halves; pressures, and how often */

ant_state ant_at(const ant_memory *o, int j, ant_real P) {
    ant_real given[6];
    ANT_LAW[j](&P, &o->eps[j], given);
    const ant_state state = {given[0], given[1], given[2], given[3], given[4], given[5]};
    return state;
}

void ant_force(const ant_memory *o, int j, ant_real P, ant_real *F, ant_real *F_P) {
    ant_real given[2];
    ANT_FORCE[j](&P, &o->eps[j], given);
    *F = given[0];
    *F_P = given[1];
}

/* The last pressure up to `hi` at which the force is below `wanted`, of some that are looked at, the closer to 0 the closer
 * together where the law falls there; 0 where it is at none. A law may fall before it rises, where its muscle is slack:
 * what is meant is the rising part. */
static ant_real last_below(const ant_memory *o, int j, ant_real hi, ant_real wanted, ant_real *above) {
    ant_real at_zero, falls, F, gain;
    ant_force(o, j, 0, &at_zero, &falls);
    *above = hi;
    for (int closer = 0; closer < CLOSER; closer++) {
        for (int i = LOOKED_AT - 1; i > 0; i--) {
            const ant_real P = hi * (ant_real)i / (ant_real)LOOKED_AT;
            ant_force(o, j, P, &F, &gain);
            if (F < wanted) return P;
            *above = P;
        }
        if (!(falls < 0)) break;
        hi /= (ant_real)LOOKED_AT;
    }
    return at_zero > wanted ? -ANT_INFINITY : 0;
}

/* Newton's steps within a bracket, halved where they leave it. */
ant_real ant_pressure(const ant_memory *o, int j, ant_real wanted) {
    ant_real lo = ANT_HI[j], hi = ANT_CEILING[j], F, gain;
    ant_force(o, j, 0, &F, &gain);
    if (ANT_STRAIGHT[j]) return (wanted - F) / gain;
    ant_force(o, j, lo, &F, &gain);
    if (F < wanted) {
        ant_force(o, j, hi, &F, &gain);
        if (!(F > wanted)) return F < wanted ? ANT_INFINITY : hi;
    } else {
        lo = last_below(o, j, lo, wanted, &hi);
        if (!(lo < hi) || isinf(lo)) return lo;
    }
    ant_real P = (lo + hi) / 2;
    for (int step = 0; step < ROOT_STEPS; step++) {
        ant_force(o, j, P, &F, &gain);
        if (F < wanted) {
            lo = P;
        } else {
            hi = P;
        }
        const ant_real next = P - (F - wanted) / gain;
        const ant_real within = next > lo && next < hi ? next : (lo + hi) / 2;
        if (ant_abs(within - P) <= ANT_SETTLED * ANT_UNIT) return within;
        P = within;
    }
    return P;
}

/* The weighted rows of C, level after level, and what is asked; what is not asked for has a row of zeros. */
static void rows(const ant_target *t, ant_memory *o) {
    const int torque_first = t->priority == ANT_TORQUE_FIRST;
    for (int i = 0; i < ANT_ROWS; i++) {
        const int row = torque_first                     ? i
                        : i < ANT_JOINTS                 ? i + ANT_STIFFNESSES
                                                         : i - ANT_JOINTS;
        const ant_real y = i < ANT_JOINTS ? t->T[i] : t->K[i - ANT_JOINTS];
        const ant_real weight = isnan(y) ? 0 : ANT_WEIGHT[i];
        o->asked[row] = isnan(y) ? 0 : weight * y;
        for (int j = 0; j < ANT_VARIABLES; j++) o->rows[row][j] = 0;
        for (int j = 0; j < ANT_MUSCLES && i < ANT_JOINTS; j++) o->rows[row][2 * j] = weight * o->arm[j][i];
    }
    int entry = 0;
    for (int i = 0; i < ANT_JOINTS; i++) {
        for (int c = i; c < ANT_JOINTS; c++, entry++) {
            const int row = torque_first ? ANT_JOINTS + entry : entry;
            const ant_real weight = isnan(t->K[entry]) ? 0 : ANT_WEIGHT[ANT_JOINTS + entry];
            for (int j = 0; j < ANT_MUSCLES; j++) {
                o->rows[row][2 * j] = weight * o->bend[j][entry];
                o->rows[row][2 * j + 1] = weight * o->arm[j][i] * o->arm[j][c];
            }
        }
    }
    o->ends[0] = 0;
    o->ends[1] = torque_first ? ANT_JOINTS : ANT_STIFFNESSES;
    o->ends[2] = ANT_ROWS;
}

void ant_pose(const ant_target *t, ant_memory *o) {
    ant_real highest[ANT_VARIABLES];
    rows(t, o);
    for (int j = 0; j < ANT_MUSCLES; j++) {
        const ant_state low = ant_at(o, j, o->lo[j]), high = ant_at(o, j, o->hi[j]);
        o->least[j] = low.F;
        o->most[j] = high.F;
        highest[2 * j] = ant_abs(high.F);
        highest[2 * j + 1] = ant_abs(high.k);
        o->reference[j] = t->nearest ? t->P_now[j] : 0;
    }
    for (int k = 0; k < 2; k++) {
        o->scale[k] = 0;
        for (int i = o->ends[k]; i < o->ends[k + 1]; i++) {
            ant_real size = ant_abs(o->asked[i]);
            for (int j = 0; j < ANT_VARIABLES; j++) size += ant_abs(o->rows[i][j]) * highest[j];
            if (size > o->scale[k]) o->scale[k] = size;
        }
    }
}

void ant_worth(const ant_memory *o, ant_found *f) {
    for (int i = 0; i < ANT_ROWS; i++) f->left[i] = -o->asked[i];
    f->costs[0] = f->costs[1] = f->costs[2] = 0;
    for (int j = 0; j < ANT_MUSCLES; j++) {
        const ant_state s = ant_at(o, j, f->P[j]);
        for (int i = 0; i < ANT_ROWS; i++) f->left[i] += o->rows[i][2 * j] * s.F + o->rows[i][2 * j + 1] * s.k;
        const ant_real away = (f->P[j] - o->reference[j]) / ANT_UNIT;
        f->costs[2] += away * away;
    }
    for (int k = 0; k < 2; k++) {
        for (int i = o->ends[k]; i < o->ends[k + 1]; i++) f->costs[k] += f->left[i] * f->left[i];
    }
}
