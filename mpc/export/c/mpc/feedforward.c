/* The commands that would follow a preview exactly, if the model were right and nothing limited: the motion needs the
 * torque T = J theta'' + b theta' + m g l sin theta - d, the allocation makes pressures of it, and the lag over a
 * sample, P_{k+1} = alpha P_k + (1 - alpha) u_k, is inverted for the commands. */
#include "control.h"
#include "tables.h"

static ant_real dot(const ant_real *a, const ant_real *b, int n) {
    ant_real sum = 0;
    for (int i = 0; i < n; i++) sum += a[i] * b[i];
    return sum;
}

static void worst(ant_real *most, ant_real gap) {
    if (ant_abs(gap) > *most) *most = ant_abs(gap);
}

void ant_feed_forward(const ant_task *task, ant_feed *feed) {
    enum { n = ANT_HORIZON + 1 };
    feed->finite = 1;
    for (int i = 0; i < 3; i++) feed->moved[i] = 0;
    for (int k = 0; k < n; k++) {
        feed->theta[k] = ant_clip(task->theta[k], ANT_LEFT, ANT_RIGHT);
        worst(&feed->moved[0], task->theta[k] - feed->theta[k]);
    }
    for (int k = 0; k < n; k++) {
        const ant_real theta = feed->theta[k], omega = dot(ANT_D1[k], feed->theta, n),
                       alpha = dot(ANT_D2[k], feed->theta, n);
        const ant_real T = ANT_INERTIA * alpha + ANT_DAMPING * omega + ANT_GRAVITY * ANT_F(sin)(theta) - task->d[k];
        ant_target target = ant_target_of(theta, task->K[k], T);
        target.min_force = ANT_MIN_FORCE;
        const ant_allocation held = ant_allocate(&target);
        feed->omega[k] = omega;
        feed->K[k] = held.K;
        feed->P[k][0] = held.P1;
        feed->P[k][1] = held.P2;
        feed->finite = feed->finite && held.status >= 0;
        worst(&feed->moved[1], task->K[k] - held.K);
        worst(&feed->moved[2], T - held.T);
    }
    for (int k = 0; k < ANT_HORIZON; k++)
        for (int i = 0; i < 2; i++) feed->u[k][i] = (feed->P[k + 1][i] - ANT_LAG[i] * feed->P[k][i]) / (1 - ANT_LAG[i]);
}
