/* An extended Kalman filter for xi = (theta, rate, P1, P2, d) from theta, P1, P2:
 *
 *     xi_{k+1} = (f_d(x_k, commands that act, d_k - T_f), d_k) + w_k,    w ~ (0, Q),      sensors' noise ~ (0, R)
 *
 * d is a random walk, so that a constant torque leaves no error in the end. The plant is evaluated only within the
 * joint range and the supply; beyond, its slope there is continued. */
#include <string.h>

#include "control.h"
#include "joint.h"
#include "model.h"
#include "tables.h"

const int ANT_MEASURED[3] = {0, 2, 3}; /* of xi */

/* P <- A P A^T + Q, A being the derivative of the plant's sample by x and d, and 1 for d. */
static void spread(ant_real P[5][5], const ant_real A[4][4], const ant_real by_d[4], const ant_real Q[5]) {
    ant_real AP[5][5];
    for (int i = 0; i < 5; i++)
        for (int j = 0; j < 5; j++) {
            AP[i][j] = i < 4 ? by_d[i] * P[4][j] : P[4][j];
            for (int l = 0; l < 4 && i < 4; l++) AP[i][j] += A[i][l] * P[l][j];
        }
    for (int i = 0; i < 5; i++)
        for (int j = 0; j < 5; j++) {
            P[i][j] = (j < 4 ? by_d[j] * AP[i][4] : AP[i][4]) + (i == j ? Q[i] : 0);
            for (int l = 0; l < 4 && j < 4; l++) P[i][j] += AP[i][l] * A[j][l];
        }
}

void ant_within(ant_real xi[5]) {
    xi[0] = ant_clip(xi[0], ANT_GATE_LOWER[0], ANT_GATE_UPPER[0]);
    xi[1] = ant_clip(xi[1], -ANT_MAX_SPEED, ANT_MAX_SPEED);
    for (int i = 2; i < 4; i++) xi[i] = ant_clip(xi[i], ANT_GATE_LOWER[i - 1], ANT_GATE_UPPER[i - 1]);
    xi[4] = ant_clip(xi[4], -ANT_MAX_TORQUE, ANT_MAX_TORQUE);
}

/* The nearest state to xi within the joint range and the supply. */
static void nearest(const ant_real xi[5], ant_real near[4]) {
    near[0] = ant_clip(xi[0], ANT_LEFT, ANT_RIGHT);
    near[1] = xi[1];
    for (int i = 2; i < 4; i++) near[i] = ant_clip(xi[i], ANT_SUPPLY_LO, ANT_SUPPLY_HI);
}

ant_contact ant_contact_of(const ant_belief *b) {
    ant_real xi[5], near[4];
    memcpy(xi, b->xi, sizeof xi);
    ant_within(xi);
    nearest(xi, near);
    return ant_contact_at(near);
}

void ant_predict_belief(const ant_observer *o, ant_belief *b, int k, const ant_real Q[5]) {
    ant_real A[4][4], B[4][2], by_d[4], later[4], near[4];
    ant_real *xi = b->xi;
    ant_within(xi);
    nearest(xi, near);
    const ant_real acting[2] = {ant_after_dead_band(o->commands[k][0], xi[2]),
                                ant_after_dead_band(o->commands[k][1], xi[3])};
    const ant_real torque = xi[4] - ant_friction_torque(o->friction.memory, ant_contact_at(near));
    ant_model_slopes(near, acting, &torque, later, A[0], B[0], by_d);
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < 4; j++) later[i] += A[i][j] * (xi[j] - near[j]);
    memcpy(xi, later, sizeof later);
    spread(b->covariance, (const ant_real(*)[4])A, by_d, Q);
}

/* After one reading, by Joseph's form, which stays symmetric and positive. */
static void correct_one(ant_belief *b, int sensor, ant_real read, ant_real noise) {
    const int m = ANT_MEASURED[sensor];
    ant_real gain[5], row[5], LP[5][5];
    const ant_real variance = b->covariance[m][m] + noise, error = read - b->xi[m];
    for (int i = 0; i < 5; i++) gain[i] = b->covariance[i][m] / variance;
    memcpy(row, b->covariance[m], sizeof row);
    for (int i = 0; i < 5; i++) {
        b->xi[i] += gain[i] * error;
        for (int j = 0; j < 5; j++) LP[i][j] = b->covariance[i][j] - gain[i] * row[j];
    }
    for (int i = 0; i < 5; i++)
        for (int j = 0; j < 5; j++)
            b->covariance[i][j] = LP[i][j] - LP[i][m] * gain[j] + gain[i] * noise * gain[j];
}

void ant_correct(const ant_observer *o, ant_belief *b, const ant_real read[3], const int there[3]) {
    for (int i = 0; i < 3; i++)
        if (there[i]) correct_one(b, i, read[i], o->noise[i]);
}

ant_real ant_innovation_variance(const ant_observer *o, const ant_belief *b, int sensor) {
    const int m = ANT_MEASURED[sensor];
    return b->covariance[m][m] + o->noise[sensor];
}

int ant_sound(const ant_belief *b) {
    for (int i = 0; i < 5; i++)
        if (!(b->covariance[i][i] > 0)) return 0;
    return ant_finite(b->xi, 5) && ant_finite(b->covariance[0], 25);
}

void ant_unsure(ant_belief *b, const ant_real read[3], const int there[3]) {
    memset(b->covariance, 0, sizeof b->covariance);
    for (int i = 0; i < 5; i++) b->covariance[i][i] = ANT_UNSURE[i];
    for (int i = 0; i < 3; i++)
        if (there[i]) b->xi[ANT_MEASURED[i]] = read[i];
}
