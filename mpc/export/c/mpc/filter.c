/* An extended Kalman filter for xi = (q, rates, P, d) of ANT_JOINTS joints and ANT_MUSCLES muscles from q and P:
 *
 *     xi_{k+1} = (f_d(x_k, commands that act, d_k - T_f), d_k) + w_k,    w ~ (0, Q),      sensors' noise ~ (0, R)
 *
 * d is a random walk, so that constant torques leave no error in the end. The plant is evaluated only within the
 * joint range and the supply; beyond, its slope there is continued. */
#include <string.h>

#include "control.h"
#include "model.h"
#include "tables.h"

enum { N = ANT_JOINTS, S = ANT_STATES, B = ANT_BELIEFS };

/* P <- A P A^T + Q, A being the derivative of the plant's sample by x and d, and 1 for d. */
static void spread(ant_real P[B][B], const ant_real A[S][S], const ant_real by_d[S][N], const ant_real Q[B]) {
    ant_real AP[B][B];
    for (int i = 0; i < B; i++)
        for (int j = 0; j < B; j++) {
            AP[i][j] = i < S ? by_d[i][0] * P[S][j] : P[i][j];
            for (int l = 1; l < N && i < S; l++) AP[i][j] += by_d[i][l] * P[S + l][j];
            for (int l = 0; l < S && i < S; l++) AP[i][j] += A[i][l] * P[l][j];
        }
    for (int i = 0; i < B; i++)
        for (int j = 0; j < B; j++) {
            P[i][j] = (j < S ? by_d[j][0] * AP[i][S] : AP[i][j]) + (i == j ? Q[i] : 0);
            for (int l = 1; l < N && j < S; l++) P[i][j] += by_d[j][l] * AP[i][S + l];
            for (int l = 0; l < S && j < S; l++) P[i][j] += AP[i][l] * A[j][l];
        }
}

void ant_within(ant_real xi[B]) {
    for (int i = 0; i < N; i++) {
        xi[i] = ant_clip(xi[i], ANT_GATE_LOWER[i], ANT_GATE_UPPER[i]);
        xi[N + i] = ant_clip(xi[N + i], -ANT_MAX_SPEED, ANT_MAX_SPEED);
        xi[S + i] = ant_clip(xi[S + i], -ANT_MAX_TORQUE, ANT_MAX_TORQUE);
    }
    for (int i = 2 * N; i < S; i++) xi[i] = ant_clip(xi[i], ANT_GATE_LOWER[i - N], ANT_GATE_UPPER[i - N]);
}

/* The nearest state to xi within the joint range and the supply. */
static void nearest(const ant_real xi[B], ant_real near[S]) {
    for (int i = 0; i < N; i++) {
        near[i] = ant_clip(xi[i], ANT_LEAST_ANGLE[i], ANT_MOST_ANGLE[i]);
        near[N + i] = xi[N + i];
    }
    for (int i = 2 * N; i < S; i++) near[i] = ant_clip(xi[i], ANT_SUPPLY_LO, ANT_SUPPLY_HI);
}

ant_real ant_acting(int muscle, ant_real u, ant_real P) {
    return P + ant_clip(ant_after_dead_band(u, P) - P, -ANT_REACH[1][muscle], ANT_REACH[0][muscle]);
}

void ant_contacts_of(const ant_belief *b, ant_contact contacts[N]) {
    ant_real xi[B], near[S];
    memcpy(xi, b->xi, sizeof xi);
    ant_within(xi);
    nearest(xi, near);
    ant_contacts_at(near, contacts);
}

void ant_predict_belief(const ant_observer *o, ant_belief *b, int k, const ant_real Q[B]) {
    ant_real A[S][S], by_u[S][ANT_MUSCLES], by_d[S][N], later[S], near[S], acting[ANT_MUSCLES], torque[N];
    ant_contact contacts[N];
    ant_real *xi = b->xi;
    ant_within(xi);
    nearest(xi, near);
    for (int i = 0; i < ANT_MUSCLES; i++) acting[i] = ant_acting(i, o->commands[k][i], xi[2 * N + i]);
    ant_contacts_at(near, contacts);
    for (int i = 0; i < N; i++) torque[i] = xi[S + i] - ant_friction_torque(o->friction[i].memory, i, contacts[i]);
    ant_model_slopes(near, acting, torque, later, A[0], by_u[0], by_d[0]);
    for (int i = 0; i < S; i++)
        for (int j = 0; j < S; j++) later[i] += A[i][j] * (xi[j] - near[j]);
    memcpy(xi, later, sizeof later);
    spread(b->covariance, (const ant_real(*)[S])A, (const ant_real(*)[N])by_d, Q);
}

/* C a: a reading by a vector like xi. The angles are older than xi by ANT_OLDER. */
static ant_real read_from(const ant_real a[B], int sensor) {
    return a[ant_measured(sensor)] - (sensor < N ? ANT_OLDER * a[N + sensor] : 0);
}

ant_real ant_foreseen(const ant_belief *b, int sensor) { return read_from(b->xi, sensor); }

ant_real ant_innovation_variance(const ant_observer *o, const ant_belief *b, int sensor) {
    ant_real column[B];
    for (int i = 0; i < B; i++) column[i] = read_from(b->covariance[i], sensor);
    return read_from(column, sensor) + o->noise[sensor];
}

/* After one reading, by Joseph's form, which stays symmetric and positive. */
static void correct_one(const ant_observer *o, ant_belief *b, int sensor, ant_real read) {
    ant_real gain[B], row[B], LP[B][B];
    const ant_real variance = ant_innovation_variance(o, b, sensor), error = read - ant_foreseen(b, sensor);
    const ant_real noise = o->noise[sensor];
    memcpy(row, b->covariance[ant_measured(sensor)], sizeof row);
    for (int j = 0; j < B && sensor < N; j++) row[j] -= ANT_OLDER * b->covariance[N + sensor][j];
    for (int i = 0; i < B; i++) gain[i] = read_from(b->covariance[i], sensor) / variance;
    for (int i = 0; i < B; i++) {
        b->xi[i] += gain[i] * error;
        for (int j = 0; j < B; j++) LP[i][j] = b->covariance[i][j] - gain[i] * row[j];
    }
    for (int i = 0; i < B; i++) {
        const ant_real left = read_from(LP[i], sensor);
        for (int j = 0; j < B; j++) b->covariance[i][j] = LP[i][j] - left * gain[j] + gain[i] * noise * gain[j];
    }
}

void ant_correct(const ant_observer *o, ant_belief *b, const ant_real read[ANT_SENSORS], const int there[ANT_SENSORS]) {
    for (int i = 0; i < ANT_SENSORS; i++)
        if (there[i]) correct_one(o, b, i, read[i]);
}

int ant_sound(const ant_belief *b) {
    for (int i = 0; i < B; i++)
        if (!(b->covariance[i][i] > 0)) return 0;
    return ant_finite(b->xi, B) && ant_finite(b->covariance[0], B * B);
}

void ant_unsure(ant_belief *b, const ant_real read[ANT_SENSORS], const int there[ANT_SENSORS]) {
    memset(b->covariance, 0, sizeof b->covariance);
    for (int i = 0; i < B; i++) b->covariance[i][i] = ANT_UNSURE[i];
    for (int i = 0; i < ANT_SENSORS; i++)
        if (there[i]) b->xi[ant_measured(i)] = read[i] + (i < N ? ANT_OLDER * b->xi[N + i] : 0);
}
