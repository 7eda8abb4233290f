/* Motion of an arm over a sample of constant commands, by the classical Runge-Kutta method along the known pressures
 * P(t) = u + (P - u) exp(-t/tau):
 *
 *     q' = w,    M(q) w' = tau - C - D w - g + d,    dw' = M^-1 d(tau - C - D w - g + d - M w') at fixed w'
 *
 * as mpc/tracking/compiled/arm/step.py has it; model.c has the formulas. */
#include "motion.h"

#include <string.h>

#include "model.h"
#include "real.h"
#include "settings.h"
#include "tables.h"

enum { N = ANT_JOINTS, M = ANT_MUSCLES, S = ANT_STATES };

typedef struct {
    ant_real mass[N][N], alpha[N]; /* Cholesky factor of the mass matrix; acceleration */
    ant_real by[S][N];             /* derivatives of the acceleration by q, rates, P, one a row */
    ant_slopes here, rate, sum;    /* of a stage, their rate, the sum of the rates */
} stage;

/* v <- M^-1 v, with the factor L in M = L L^T. */
static void solve(const ant_real (*L)[N], ant_real *v) {
    for (int i = 0; i < N; i++) {
        for (int l = 0; l < i; l++) v[i] -= L[i][l] * v[l];
        v[i] /= L[i][i];
    }
    for (int i = N - 1; i >= 0; i--) {
        for (int l = i + 1; l < N; l++) v[i] -= L[l][i] * v[l];
        v[i] /= L[i][i];
    }
}

static void accelerate(const ant_real z[ANT_MOVING], const ant_real P[M], const ant_real d[N], stage *g) {
    ant_model_dynamics(z, z + N, P, d, g->mass[0], g->alpha);
    for (int j = 0; j < N; j++)
        for (int i = j; i < N; i++) {
            ant_real value = g->mass[i][j];
            for (int l = 0; l < j; l++) value -= g->mass[i][l] * g->mass[j][l];
            g->mass[i][j] = i == j ? ANT_F(sqrt)(value) : value / g->mass[j][j];
        }
    solve((const ant_real(*)[N])g->mass, g->alpha);
}

/* The variational equations by a stage: after `reach` [s] at the last rate, for a `share` of the sum, where `left` of a
 * pressure's error is left. */
static void vary(const ant_real z[ANT_MOVING], const ant_real P[M], const ant_real left[M], ant_real reach,
                 ant_real share, const ant_slopes *slopes, stage *g) {
    ant_model_dynamics_slopes(z, z + N, P, g->alpha, g->by[0]);
    for (int j = 0; j < S; j++) solve((const ant_real(*)[N])g->mass, g->by[j]);
    for (int i = 0; i < ANT_MOVING; i++)
        for (int j = 0; j < ANT_COLUMNS; j++) g->here[i][j] = (*slopes)[i][j] + reach * g->rate[i][j];
    for (int i = 0; i < N; i++) {
        ant_real *rate = g->rate[N + i];
        memcpy(g->rate[i], g->here[N + i], sizeof g->rate[i]);
        for (int j = 0; j < ANT_COLUMNS; j++) rate[j] = 0;
        for (int l = 0; l < ANT_MOVING; l++)
            for (int j = 0; j < ANT_COLUMNS; j++) rate[j] += g->by[l][i] * g->here[l][j];
        for (int j = 0; j < M; j++) {
            rate[ANT_MOVING + j] += g->by[ANT_MOVING + j][i] * left[j];
            rate[S + j] += g->by[ANT_MOVING + j][i] * (1 - left[j]);
        }
    }
    for (int l = 0; l < N; l++) { /* by d */
        ant_real column[N] = {0};
        column[l] = 1;
        solve((const ant_real(*)[N])g->mass, column);
        for (int i = 0; i < N; i++) g->rate[N + i][ANT_BY_D + l] += column[i];
    }
    for (int i = 0; i < ANT_MOVING; i++)
        for (int j = 0; j < ANT_COLUMNS; j++) g->sum[i][j] += share * g->rate[i][j];
}

void ant_advance(const ant_real x[S], const ant_real u[M], const ant_real d[N], ant_real later[S], ant_slopes *slopes) {
    static const ant_real nodes[4] = {0, ANT_R(0.5), ANT_R(0.5), 1};
    static const ant_real shares[4] = {ANT_R(1.0) / 6, ANT_R(1.0) / 3, ANT_R(1.0) / 3, ANT_R(1.0) / 6};
    static const int places[4] = {0, 1, 1, 2}; /* of a step: its beginning, middle, end */
    const ant_real h = ANT_DT / ANT_SUBSTEPS;
    ant_real z[ANT_MOVING], now[ANT_MOVING], rate[ANT_MOVING], sum[ANT_MOVING], P[M];
    stage g;
    memcpy(z, x, sizeof z);
    for (int i = 0; i < ANT_MOVING && slopes != NULL; i++)
        for (int j = 0; j < ANT_COLUMNS; j++) (*slopes)[i][j] = i == j;
    for (int step = 0; step < ANT_SUBSTEPS; step++) {
        memset(rate, 0, sizeof rate);
        memset(sum, 0, sizeof sum);
        memset(g.rate, 0, sizeof g.rate);
        memset(g.sum, 0, sizeof g.sum);
        for (int part = 0; part < 4; part++) {
            const ant_real reach = h * nodes[part], share = h * shares[part];
            const ant_real *left = ANT_DECAY[3 * step + places[part]];
            for (int i = 0; i < ANT_MOVING; i++) now[i] = z[i] + reach * rate[i];
            for (int j = 0; j < M; j++) P[j] = u[j] + left[j] * (x[ANT_MOVING + j] - u[j]);
            accelerate(now, P, d, &g);
            for (int i = 0; i < N; i++) {
                rate[i] = now[N + i];
                rate[N + i] = g.alpha[i];
            }
            for (int i = 0; i < ANT_MOVING; i++) sum[i] += share * rate[i];
            if (slopes != NULL) vary(now, P, left, reach, share, (const ant_slopes *)slopes, &g);
        }
        for (int i = 0; i < ANT_MOVING; i++) z[i] += sum[i];
        for (int i = 0; i < ANT_MOVING && slopes != NULL; i++)
            for (int j = 0; j < ANT_COLUMNS; j++) (*slopes)[i][j] += g.sum[i][j];
    }
    for (int j = 0; j < M; j++) later[ANT_MOVING + j] = u[j] + ANT_KEPT[j] * (x[ANT_MOVING + j] - u[j]);
    memcpy(later, z, sizeof z);
}

void ant_model_stage(const ant_real *x, const ant_real *u, const ant_real *d, ant_real *later) {
    ant_advance(x, u, d, later, NULL);
}

void ant_model_slopes(const ant_real *x, const ant_real *u, const ant_real *d, ant_real *later, ant_real *A,
                      ant_real *B, ant_real *by_d) {
    ant_slopes slopes;
    ant_advance(x, u, d, later, &slopes);
    for (int i = 0; i < S; i++) {
        for (int j = 0; j < S; j++) A[i * S + j] = i < ANT_MOVING ? slopes[i][j] : i == j ? ANT_KEPT[i - ANT_MOVING] : 0;
        for (int j = 0; j < M; j++)
            B[i * M + j] = i < ANT_MOVING ? slopes[i][S + j] : i - ANT_MOVING == j ? 1 - ANT_KEPT[j] : 0;
        for (int j = 0; j < N; j++) by_d[i * N + j] = i < ANT_MOVING ? slopes[i][ANT_BY_D + j] : 0;
    }
}
