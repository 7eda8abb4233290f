/* Rate of an arm's angles and velocities, with gas of its pressures as well, and of their derivatives. Without gas the
 * pressures are known, P(t) = u + (P - u) exp(-t/tau):
 *
 *     q' = w,    M(q) w' = tau - C - D w - g + d,    dw' = M^-1 d(tau - C - D w - g + d - M w') at fixed w'
 *
 * as mpc/model/arm/compiled/motion.py has it; model.c has the formulas. */
#include <string.h>

#include "model.h"
#include "real.h"
#include "settings.h"
#include "tables.h"

enum { N = ANT_JOINTS, M = ANT_MUSCLES, S = ANT_STATES, MOVING = ANT_MOVING, ALONE = S - MOVING };

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

/* The Cholesky factor of the mass matrix in its place, and the acceleration. */
static void accelerate(const ant_real *z, const ant_real *P, const ant_real *d, ant_real (*mass)[N], ant_real *alpha) {
    ant_model_dynamics(z, z + N, P, d, mass[0], alpha);
    for (int j = 0; j < N; j++)
        for (int i = j; i < N; i++) {
            ant_real value = mass[i][j];
            for (int l = 0; l < j; l++) value -= mass[i][l] * mass[j][l];
            mass[i][j] = i == j ? ANT_F(sqrt)(value) : value / mass[j][j];
        }
    solve((const ant_real(*)[N])mass, alpha);
}

/* The rate of S, where `left` of a pressure's error is left. */
static void vary(const ant_real *z, const ant_real *P, const ant_real *alpha, const ant_real (*mass)[N],
                 const ant_real *left, const ant_real (*here)[ANT_COLUMNS], ant_real (*rate)[ANT_COLUMNS]) {
    ant_real by[S + N][N] = {{0}}; /* derivatives of the acceleration by q, w, P and d, one a row */
    ant_model_dynamics_slopes(z, z + N, P, alpha, by[0]);
    for (int l = 0; l < N; l++) by[S + l][l] = 1;
    for (int j = 0; j < S + N; j++) solve(mass, by[j]);
    memcpy(rate, here + N, N * sizeof *rate);
    memset(rate + N, 0, N * sizeof *rate);
    for (int i = 0; i < N; i++) {
        ant_real *row = rate[N + i];
        for (int l = 0; l < MOVING; l++)
            for (int j = 0; j < ANT_COLUMNS; j++) row[j] += by[l][i] * here[l][j];
        for (int j = 0; j < ALONE; j++) {
            row[2 * N + j] += by[2 * N + j][i] * left[j];
            row[S + j] += by[2 * N + j][i] * (1 - left[j]);
        }
        for (int l = 0; l < N; l++) row[ANT_BY_D + l] += by[S + l][i];
    }
}

#ifdef ANT_GAS
/* The rate of the last lines of S. */
static void vary_pressures(const ant_real *z, const ant_real *P, const ant_real (*here)[ANT_COLUMNS],
                           ant_real (*rate)[ANT_COLUMNS]) {
    ant_real by[S][M], by_command[M];
    ant_model_pressure_slopes(z, z + N, P, by[0], by_command);
    memset(rate + 2 * N, 0, M * sizeof *rate);
    for (int i = 0; i < M; i++) {
        ant_real *row = rate[2 * N + i];
        for (int l = 0; l < S; l++)
            for (int j = 0; j < ANT_COLUMNS; j++) row[j] += by[l][i] * here[l][j];
        row[S + i] += by_command[i];
    }
}
#endif

void ant_rate(const ant_real *y, int length, const ant_real *x, const ant_real *u, const ant_real *d, int step,
              int place, ant_real *rate) {
    const ant_real *left = ANT_DECAY[3 * step + place];
    const ant_real(*here)[ANT_COLUMNS] = (const ant_real(*)[ANT_COLUMNS])(y + MOVING);
    ant_real(*varied)[ANT_COLUMNS] = (ant_real(*)[ANT_COLUMNS])(rate + MOVING);
    ant_real mass[N][N], P[M];
    for (int j = 0; j < M; j++) P[j] = ALONE ? u[j] + left[j] * (x[2 * N + j] - u[j]) : y[2 * N + j];
    memcpy(rate, y + N, N * sizeof *rate);
    accelerate(y, P, d, mass, rate + N);
    if (length > MOVING) vary(y, P, rate + N, (const ant_real(*)[N])mass, left, here, varied);
#ifdef ANT_GAS
    ant_model_pressures(y, y + N, P, u, rate + 2 * N);
    if (length > MOVING) vary_pressures(y, P, here, varied);
#endif
}

/* The pressures after a sample that are not integrated. */
static void decay(const ant_real *x, const ant_real *u, ant_real *later) {
    for (int j = 0; j < ALONE; j++) later[2 * N + j] = u[j] + ANT_KEPT[j] * (x[2 * N + j] - u[j]);
}

void ant_model_stage(const ant_real *x, const ant_real *u, const ant_real *d, ant_real *later) {
    memcpy(later, x, MOVING * sizeof *x);
    ant_advance(later, MOVING, x, u, d);
    decay(x, u, later);
}

void ant_model_slopes(const ant_real *x, const ant_real *u, const ant_real *d, ant_real *later, ant_real *A,
                      ant_real *B, ant_real *by_d) {
    ant_real y[ANT_VARIED] = {0}, (*slopes)[ANT_COLUMNS] = (ant_real(*)[ANT_COLUMNS])(y + MOVING);
    memcpy(y, x, MOVING * sizeof *x);
    for (int i = 0; i < MOVING; i++) slopes[i][i] = 1;
    ant_advance(y, ANT_VARIED, x, u, d);
    memcpy(later, y, MOVING * sizeof *y);
    decay(x, u, later);
    for (int i = 0; i < S; i++) {
        for (int j = 0; j < S; j++) A[i * S + j] = i < MOVING ? slopes[i][j] : i == j ? ANT_KEPT[i - 2 * N] : 0;
        for (int j = 0; j < M; j++)
            B[i * M + j] = i < MOVING ? slopes[i][S + j] : i - 2 * N == j ? 1 - ANT_KEPT[j] : 0;
        for (int j = 0; j < N; j++) by_d[i * N + j] = i < MOVING ? slopes[i][ANT_BY_D + j] : 0;
    }
}
