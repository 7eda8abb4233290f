/* An extended Kalman filter for xi = (theta, rate, P1, P2, d) from theta, P1, P2:
 *
 *     xi_{k+1} = (f_d(x_k, heard commands, d_k - T_f), d_k) + w_k,    w ~ (0, Q),      sensors' noise ~ (0, R)
 *
 * d is a random walk, so that nothing of a constant torque is left in the end. A sensor may be silent (NaN) or frozen
 * for ANT_TOLERANCE seconds; after that what it should measure is NaN until it speaks again. */
#include <string.h>

#include "control.h"
#include "model.h"
#include "tables.h"

static const int MEASURED[3] = {0, 2, 3}; /* of xi */

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

/* One sample on, the friction's state being z. */
static void predict(const ant_observer *o, ant_belief *b, ant_real z, const ant_real Q[5]) {
    ant_real A[4][4], by_d[4], x[4];
    const ant_real *xi = b->xi;
    const ant_real heard[2] = {ant_heard(o->commands[0][0], xi[2]), ant_heard(o->commands[0][1], xi[3])};
    const ant_real torque = xi[4] - ant_friction_limit(xi) * z;
    ant_model_observed(xi, heard, &torque, x, A[0], by_d);
    memcpy(b->xi, x, sizeof x);
    spread(b->covariance, (const ant_real(*)[4])A, by_d, Q);
}

/* After one reading, by Joseph's form, which stays symmetric and positive. */
static void correct_one(ant_belief *b, int sensor, ant_real read) {
    const int m = MEASURED[sensor];
    ant_real gain[5], row[5], LP[5][5];
    const ant_real variance = b->covariance[m][m] + ANT_R_NOISE[sensor], error = read - b->xi[m];
    for (int i = 0; i < 5; i++) gain[i] = b->covariance[i][m] / variance;
    memcpy(row, b->covariance[m], sizeof row);
    for (int i = 0; i < 5; i++) {
        b->xi[i] += gain[i] * error;
        for (int j = 0; j < 5; j++) LP[i][j] = b->covariance[i][j] - gain[i] * row[j];
    }
    for (int i = 0; i < 5; i++)
        for (int j = 0; j < 5; j++)
            b->covariance[i][j] = LP[i][j] - LP[i][m] * gain[j] + gain[i] * ANT_R_NOISE[sensor] * gain[j];
}

static void correct(ant_belief *b, const ant_real read[3], const int there[3]) {
    for (int i = 0; i < 3; i++)
        if (there[i]) correct_one(b, i, read[i]);
}

/* Whether a reading is too far from what is foreseen without it. */
static int doubtful(const ant_belief *foreseen, int sensor, ant_real read) {
    const int m = MEASURED[sensor];
    const ant_real error = read - foreseen->xi[m];
    return error * error > ANT_DOUBT * ANT_DOUBT * (foreseen->covariance[m][m] + ANT_R_NOISE[sensor]);
}

/* What is thought without a sensor that repeats itself; if that contradicts it for long enough, it is frozen. */
static void suspect(ant_observer *o, int i, ant_real z, const ant_belief *before, ant_belief *expected,
                    const ant_real read[3], const int others[3]) {
    if (!o->repeats[i]) o->without[i] = *before;
    o->repeats[i] = 1;
    predict(o, &o->without[i], z, ANT_Q_REST);
    if (!o->frozen[i] && o->repeating[i] > ANT_TOLERANCE && doubtful(&o->without[i], i, read[i])) {
        o->frozen[i] = 1;
        *expected = o->without[i];
    }
    correct(&o->without[i], read, others);
}

/* What is thought of this sample before it is read; notes which sensors are frozen. */
static void expect(ant_observer *o, const ant_real read[3]) {
    const ant_belief before = o->belief;
    const ant_real z = ant_friction_follow(&o->friction, before.xi[0]);
    int others[3];
    for (int i = 0; i < 3; i++) {
        const int repeated = read[i] == o->read[i];
        o->repeating[i] = repeated ? o->repeating[i] + ANT_DT : 0;
        o->frozen[i] = o->frozen[i] && repeated;
        others[i] = isfinite(read[i]) && !repeated;
    }
    predict(o, &o->belief, z, ANT_Q_NOISE);
    for (int i = 0; i < 3; i++) {
        if (o->repeating[i] > 0)
            suspect(o, i, z, &before, &o->belief, read, others);
        else
            o->repeats[i] = 0;
    }
}

static void remember(ant_observer *o, const ant_real sent[2]) {
    for (int k = 0; k < ANT_DELAY; k++) memcpy(o->commands[k], o->commands[k + 1], sizeof o->commands[k]);
    for (int i = 0; i < 2; i++)
        if (isfinite(sent[i])) o->commands[ANT_DELAY][i] = sent[i];
}

static int start(ant_observer *o, const ant_real read[3], const ant_real sent[2]) {
    if (!ant_finite(read, 3) || !ant_finite(sent, 2)) return 0;
    memset(o, 0, sizeof *o);
    for (int i = 0; i < 3; i++) o->belief.xi[MEASURED[i]] = read[i];
    memcpy(o->belief.covariance, ANT_COVARIANCE, sizeof o->belief.covariance);
    for (int k = 0; k <= ANT_DELAY; k++) memcpy(o->commands[k], sent, sizeof o->commands[k]);
    o->begun = 1;
    return 1;
}

/* A reading beyond what any sensor could say counts as none. */
static ant_real plausible(ant_real read, ant_real most) { return ant_abs(read) <= most ? read : ANT_NAN; }

int ant_estimate(ant_observer *o, const ant_reading *reading, const ant_real sent[2], ant_real x[4], ant_real *d) {
    const ant_real read[3] = {plausible(reading->theta, ANT_MOST_THETA), plausible(reading->P1, ANT_MOST_PRESSURE),
                              plausible(reading->P2, ANT_MOST_PRESSURE)};
    int there[3];
    if (o->begun) {
        remember(o, sent);
        expect(o, read);
    } else if (!start(o, read, sent)) {
        return 0;
    }
    for (int i = 0; i < 3; i++) there[i] = isfinite(read[i]) && !o->frozen[i];
    correct(&o->belief, read, there);
    if (!ant_finite(o->belief.xi, 5)) { /* begin anew with the next reading */
        o->begun = 0;
        return 0;
    }
    memcpy(x, o->belief.xi, 4 * sizeof x[0]);
    for (int i = 0; i < 3; i++) {
        const ant_real least = o->frozen[i] && o->repeating[i] > o->silent[i] ? o->repeating[i] : o->silent[i];
        o->silent[i] = there[i] ? 0 : least + ANT_DT;
        if (o->silent[i] > ANT_TOLERANCE_END) x[MEASURED[i]] = ANT_NAN;
    }
    memcpy(o->read, read, sizeof o->read);
    *d = o->belief.xi[4];
    return 1;
}
