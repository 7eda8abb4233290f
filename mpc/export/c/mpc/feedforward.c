/* Commands that follow a preview exactly if the model is right and no limit binds. The motion needs the torques
 * M q'' + C + D q' + g - d, the allocation converts them to pressures, and the lag over a sample,
 * P_{k+1} = alpha P_k + (1 - alpha) (u_k - tau q_k), is inverted for the commands. q is the pressure loss by expansion
 * of the muscles; its mean over the sample is the mean of both ends. tau is that of a rising pressure if a regulator has
 * to fill, else that of a falling one. */
#include "control.h"
#include "model.h"
#include "tables.h"

enum { N = ANT_JOINTS, SAMPLES = ANT_HORIZON + 1 };

/* Mean rate of an angle over the sample k. */
static ant_real secant(const ant_feed *feed, int k, int i) { return (feed->x[k + 1][i] - feed->x[k][i]) / ANT_DT; }

/* Rates of an angle: slopes of a cubic spline, whose third derivative is continuous at the samples beside its ends. */
static void rates(ant_feed *feed, int i) {
    enum { LAST = ANT_HORIZON };
    ant_real shares[LAST] = {2}; /* of the next rate in each one */
    feed->x[0][N + i] = (5 * secant(feed, 0, i) + secant(feed, 1, i)) / 2;
    for (int k = 1; k < LAST; k++) {
        shares[k] = 1 / (4 - shares[k - 1]);
        feed->x[k][N + i] =
            shares[k] * (3 * (secant(feed, k - 1, i) + secant(feed, k, i)) - feed->x[k - 1][N + i]);
    }
    const ant_real end = (secant(feed, LAST - 2, i) + 5 * secant(feed, LAST - 1, i)) / 2;
    feed->x[LAST][N + i] = (end - 2 * feed->x[LAST - 1][N + i]) / (1 - 2 * shares[LAST - 1]);
    for (int k = LAST - 1; k >= 0; k--) feed->x[k][N + i] -= shares[k] * feed->x[k + 1][N + i];
}

/* Second derivative of the spline. */
static ant_real acceleration(const ant_feed *feed, int k, int i) {
    if (k == ANT_HORIZON)
        return 2 * (feed->x[k - 1][N + i] + 2 * feed->x[k][N + i] - 3 * secant(feed, k - 1, i)) / ANT_DT;
    return 2 * (3 * secant(feed, k, i) - 2 * feed->x[k][N + i] - feed->x[k + 1][N + i]) / ANT_DT;
}

static void worst(ant_real *most, ant_real gap) {
    if (ant_abs(gap) > *most) *most = ant_abs(gap);
}

/* Angles within the joint range. */
static void reachable(const ant_task *task, ant_feed *feed) {
    feed->finite = 1;
    for (int i = 0; i < 3; i++) feed->moved[i] = 0;
    for (int k = 0; k < SAMPLES; k++)
        for (int i = 0; i < N; i++) {
            feed->x[k][i] = ant_clip(task->theta[k][i], ANT_LEAST_ANGLE[i], ANT_MOST_ANGLE[i]);
            worst(&feed->moved[0], task->theta[k][i] - feed->x[k][i]);
        }
}

/* Pressures at a sample. */
static void hold(const ant_task *task, ant_real min_force, int k, ant_feed *feed) {
    ant_real *x = feed->x[k], *y = feed->y[k], alpha[N], T[N];
    for (int i = 0; i < N; i++) alpha[i] = acceleration(feed, k, i);
    ant_model_torque_for(x, x + N, alpha, T);
    for (int i = 0; i < N; i++) T[i] -= task->d[k][i];
    ant_real left[N], K[ANT_STIFFNESSES];
    feed->finite = ant_held(x, task->K[k], T, min_force, &feed->memory, x + 2 * N, left, K) && feed->finite;
    for (int i = 0; i < N; i++) worst(&feed->moved[2], left[i]);
    for (int i = 0; i < ANT_STIFFNESSES; i++) {
        worst(&feed->moved[1], task->K[k][i] - K[i]);
        y[i] = ANT_SVEC[i] * K[i];
    }
    for (int i = ANT_STIFFNESSES; i < ANT_OUTPUTS; i++) y[i] = 0;
}

/* Command for a pressure to become `after` in a sample while it loses q per second. */
static ant_real command(int i, ant_real before, ant_real after, ant_real q) {
    const int falls = !(after - before + ANT_DT * q > 0);
    const ant_real left = ANT_WAY_KEPT[falls][i];
    return (after - left * before) / (1 - left) + ANT_WAY_LAGS[falls][i] * q;
}

void ant_feed_forward(const ant_task *task, ant_real min_force, ant_feed *feed) {
    reachable(task, feed);
    for (int i = 0; i < N; i++) rates(feed, i);
    for (int k = 0; k < SAMPLES; k++) hold(task, min_force, k, feed);
    ant_real q[ANT_MUSCLES], last[ANT_MUSCLES];
    ant_model_expansion(feed->x[0], q);
    for (int k = 0; k < ANT_HORIZON; k++) {
        for (int i = 0; i < ANT_MUSCLES; i++) last[i] = q[i];
        ant_model_expansion(feed->x[k + 1], q);
        for (int i = 0; i < ANT_MUSCLES; i++)
            feed->u[k][i] = command(i, feed->x[k][2 * N + i], feed->x[k + 1][2 * N + i], (q[i] + last[i]) / 2);
    }
}
