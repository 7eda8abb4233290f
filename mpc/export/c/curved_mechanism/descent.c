/* Pressures go down to a local optimum of all levels, by Gauss and Newton's method: about the pressures of a step every
 * muscle's F and k are straight lines, which the kernel solves exactly within a trust region. The step is taken in the
 * forces, so that torques are what the step has meant them to be. As in Python's relaxation/descent.py. */
#include "curved.h"
#include "mechanism.h"
#include "real.h"

enum { RESTORED = 2, NEWTON = 8, LAST = 2 }; /* steps back to what the earlier levels had; of an inverse; of the costs */

#define MATTERS ANT_R(1e-4)   /* of a level's Hessian: less of what bends it is left out */
#define CONTRACTS ANT_R(0.9)  /* from one step to the next: so much smaller are those that settle */
#define STRETCHES ANT_R(0.05) /* between it and its inverse the Hessian's diagonal is kept */

typedef ant_real diagonals[3][ANT_MUSCLES]; /* roots, of both levels and of the distance from the reference */
typedef ant_real multipliers[3][ANT_ROWS];

static ant_real least_of(ant_real a, ant_real b) { return a < b ? a : b; }
static ant_real greatest_of(ant_real a, ant_real b) { return a > b ? a : b; }

/* Make the problem of the straight lines about P, in bent[2] P / unit, the box and its centre being given in [Pa]; what
 * is bent upwards in a level is a row of its own. Level 0 is empty, and states beyond the muscles are held at 0. */
static void linear(ant_memory *o, const ant_real *P, const ant_real *left, const ant_real *lo, const ant_real *hi,
                   const ant_real *centre, diagonals bent) {
    for (int i = 0; i < ANT_LINES; i++) {
        for (int j = 0; j < ANT_VARIABLES; j++) o->A[i][j] = 0;
        o->b[i] = 0;
        o->onesided[i] = 0;
    }
    for (int j = ANT_MUSCLES; j < ANT_VARIABLES; j++) o->lo_x[j] = o->hi_x[j] = o->centre[j] = 0;
    for (int j = 0; j < ANT_MUSCLES; j++) {
        const ant_state s = ant_at(o, j, P[j]);
        const ant_real unit = ANT_UNIT / bent[LAST][j];
        o->lo_x[j] = lo[j] / unit;
        o->hi_x[j] = hi[j] / unit;
        o->centre[j] = centre[j] / unit;
        for (int k = 0, line = 0; k < 2; k++, line += ANT_MUSCLES) {
            for (int i = o->ends[k]; i < o->ends[k + 1]; i++, line++) {
                o->A[line][j] = (o->rows[i][2 * j] * s.F_P + o->rows[i][2 * j + 1] * s.k_P) * unit;
                o->b[line] += o->A[line][j] * P[j] / unit - (j == 0 ? left[i] : 0);
            }
            o->A[line + j][j] = bent[k][j] / bent[LAST][j];
            o->b[line + j] = o->A[line + j][j] * P[j] / unit;
        }
    }
    o->kernel_ends[0] = 0;
    o->kernel_ends[1] = o->ends[1] + ANT_MUSCLES;
    o->kernel_ends[2] = ANT_LINES;
}

/* Solve it, and pick the multipliers of the model's rows. */
static void solve(ant_memory *o, multipliers mu) {
    const ant_levels levels = {(const ant_real(*)[ANT_VARIABLES])o->A, o->b, o->onesided, o->kernel_ends};
    const ant_box box = {o->lo_x, o->hi_x, o->centre};
    ant_kernel_prepare(&levels, &o->work);
    ant_kernel_solve(&levels, &box, o->x, o->side, o->mu, 0, &o->work);
    for (int level = 0; level < 3; level++) {
        for (int k = 0, line = 0; k < 2; k++, line += ANT_MUSCLES) {
            for (int i = o->ends[k]; i < o->ends[k + 1]; i++, line++) mu[level][i] = o->mu[level + 1][line];
        }
    }
}

/* Move the pressures from P to where the forces are what the straight lines say of x. */
static void inverted(const ant_memory *o, const ant_real *P, const ant_real *x, ant_real *found) {
    ant_real wanted[ANT_MUSCLES];
    for (int j = 0; j < ANT_MUSCLES; j++) {
        ant_real F, gain;
        ant_force(o, j, P[j], &F, &gain);
        wanted[j] = F + gain * (x[j] - P[j]);
        found[j] = ant_clip(x[j], o->lo[j], o->hi[j]);
    }
    for (int step = 0; step < NEWTON; step++) {
        ant_real moved = 0;
        for (int j = 0; j < ANT_MUSCLES; j++) {
            ant_real F, gain;
            ant_force(o, j, found[j], &F, &gain);
            const ant_real off = (wanted[j] - F) / gain;
            found[j] = ant_clip(found[j] + off, o->lo[j], o->hi[j]);
            moved = greatest_of(moved, ant_abs(off));
        }
        if (moved <= ANT_SETTLED * ANT_UNIT) return;
    }
}

/* Take one step from `from`, `radius` of the supply at most, to `to`; of equally good ones that with the least
 * sum of bent[2]^2 (P - from)^2 / 2 + (from - centre) P. */
static void one_step(ant_memory *o, const ant_found *from, ant_real radius, const ant_real *centre, diagonals bent,
                     multipliers mu, ant_real *to) {
    const ant_real near = ANT_AT_BOUND * ANT_UNIT, reach = radius * ANT_UNIT;
    ant_real least[ANT_MUSCLES], most[ANT_MUSCLES], low[ANT_MUSCLES], high[ANT_MUSCLES], drawn[ANT_MUSCLES];
    ant_real x[ANT_MUSCLES], found[ANT_MUSCLES];
    for (int j = 0; j < ANT_MUSCLES; j++) {
        const ant_real P = from->P[j];
        ant_real F, gain;
        ant_force(o, j, P, &F, &gain);
        least[j] = P + (o->least[j] - F) / gain;
        most[j] = P + (o->most[j] - F) / gain;
        low[j] = greatest_of(least_of(least[j], P), P - reach);
        high[j] = least_of(greatest_of(most[j], P), P + reach);
        drawn[j] = P + (centre[j] - P) / (bent[LAST][j] * bent[LAST][j]);
    }
    linear(o, from->P, from->left, low, high, drawn, bent);
    solve(o, mu);
    for (int j = 0; j < ANT_MUSCLES; j++) x[j] = o->x[j] * ANT_UNIT / bent[LAST][j];
    inverted(o, from->P, x, found);
    for (int j = 0; j < ANT_MUSCLES; j++) {
        to[j] = x[j] <= least[j] + near ? o->lo[j] : x[j] >= most[j] - near ? o->hi[j] : found[j];
    }
}

/* Fill in the roots of the diagonals that the curves add to the Hessians of the levels' Lagrangians: of the levels in
 * forces, along which torques are straight, and only what is bent upwards; of the distance in pressures. */
static void bend(const ant_memory *o, const ant_real *P, multipliers mu, diagonals bent) {
    ant_state s[ANT_MUSCLES];
    ant_real straight[2] = {0, 0};
    for (int j = 0; j < ANT_MUSCLES; j++) {
        s[j] = ant_at(o, j, P[j]);
        for (int k = 0; k < 2; k++) {
            for (int i = o->ends[k]; i < o->ends[k + 1]; i++) {
                const ant_real by_F = o->rows[i][2 * j] * s[j].F_P * ANT_UNIT;
                const ant_real by_k = o->rows[i][2 * j + 1] * s[j].k_P * ANT_UNIT;
                straight[k] = greatest_of(straight[k], greatest_of(by_F * by_F, by_k * by_k));
            }
        }
    }
    for (int k = 0; k < 3; k++) {
        for (int j = 0; j < ANT_MUSCLES; j++) {
            ant_real by_F = 0, by_k = 0;
            for (int i = 0; i < ANT_ROWS; i++) {
                by_F += mu[k][i] * o->rows[i][2 * j];
                by_k += mu[k][i] * o->rows[i][2 * j + 1];
            }
            ant_real square;
            if (k == LAST) {
                square = 1 + (by_F * s[j].F_PP + by_k * s[j].k_PP) * ANT_UNIT * ANT_UNIT;
                square = ant_clip(square, STRETCHES, 1 / STRETCHES);
            } else {
                square = by_k * (s[j].k_PP - s[j].k_P * s[j].F_PP / s[j].F_P) * ANT_UNIT * ANT_UNIT;
                if (!(square > MATTERS * straight[k])) square = 0;
            }
            bent[k][j] = ANT_F(sqrt)(square);
        }
    }
}

int ant_lower(const ant_memory *o, const ant_found *new, const ant_found *old, ant_real alike) {
    for (int k = 0; k < 3; k++) {
        const ant_real scale = k < LAST ? ANT_NOTHING * o->scale[k] : ANT_ALIGNED;
        const ant_real change = new->costs[k] - old->costs[k];
        if (!(ant_abs(change) <= scale * scale + alike * old->costs[k])) return change < 0;
    }
    return 1;
}

void ant_descend(ant_memory *o, ant_found *now, int steps) {
    ant_real radius = 1, last = ANT_INFINITY;
    diagonals bent;
    for (int j = 0; j < ANT_MUSCLES; j++) {
        bent[0][j] = bent[1][j] = 0;
        bent[LAST][j] = 1;
    }
    ant_worth(o, now);
    for (int step = 0; step < steps; step++) {
        ant_found tried;
        multipliers mu, ignored;
        one_step(o, now, radius, o->reference, bent, mu, tried.P);
        for (int back = 0; back < RESTORED; back++) {
            ant_worth(o, &tried);
            const ant_found from = tried;
            one_step(o, &from, radius, from.P, bent, ignored, tried.P);
        }
        ant_worth(o, &tried);
        ant_real moved = 0;
        for (int j = 0; j < ANT_MUSCLES; j++) moved = greatest_of(moved, ant_abs(tried.P[j] - now->P[j]) / ANT_UNIT);
        const int good = ant_lower(o, &tried, now, ANT_CHANGES) ||
                         (moved < CONTRACTS * last && ant_lower(o, &tried, now, ANT_ALIKE));
        if (good) *now = tried;
        bend(o, now->P, mu, bent);
        last = moved;
        radius = good ? least_of(2 * radius, 1) : least_of(radius, moved) / 4;
        if (!(moved > ANT_SETTLED && radius > ANT_SMALLEST)) return;
    }
}

ant_real ant_certified(ant_memory *o, const ant_found *found) {
    multipliers mu;
    diagonals bent;
    for (int k = 0; k < 3; k++) {
        for (int i = 0; i < ANT_ROWS; i++) {
            mu[k][i] = k < LAST && i >= o->ends[k] && i < o->ends[k + 1] ? found->left[i] : 0;
        }
    }
    bend(o, found->P, mu, bent);
    linear(o, found->P, found->left, o->lo, o->hi, o->reference, bent);
    solve(o, mu);
    o->work.scales[0][0] = o->work.scales[1][0] = 1; /* of the empty level */
    for (int j = 0; j < ANT_MUSCLES; j++) o->x[j] = found->P[j] / ANT_UNIT;
    const ant_levels levels = {(const ant_real(*)[ANT_VARIABLES])o->A, o->b, o->onesided, o->kernel_ends};
    const ant_box box = {o->lo_x, o->hi_x, o->centre};
    return ant_kernel_residual(&levels, &box, o->x, o->mu, 0, ANT_BINDS, o->held, &o->work);
}
