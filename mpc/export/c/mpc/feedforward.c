/* Commands that follow a preview exactly if the model is right and no limit binds. The motion needs the torque
 * T = J theta'' + b theta' + m g l sin theta - d, the allocation converts it to pressures, and the lag over a sample,
 * P_{k+1} = alpha P_k + (1 - alpha) (u_k - tau q_k), is inverted for the commands. q is the pressure loss by expansion
 * of the muscles; its mean over the sample is the mean of both ends. */
#include "control.h"
#include "model.h"
#include "tables.h"

/* A derivative of the angle. */
static ant_real derivative(const ant_real *row, const ant_feed *feed) {
    ant_real sum = 0;
    for (int k = 0; k <= ANT_HORIZON; k++) sum += row[k] * feed->x[k][0];
    return sum;
}

static void worst(ant_real *most, ant_real gap) {
    if (ant_abs(gap) > *most) *most = ant_abs(gap);
}

void ant_feed_forward(const ant_task *task, ant_real min_force, ant_feed *feed) {
    enum { n = ANT_HORIZON + 1 };
    feed->finite = 1;
    for (int i = 0; i < 3; i++) feed->moved[i] = 0;
    for (int k = 0; k < n; k++) {
        feed->x[k][0] = ant_clip(task->theta[k], ANT_LEFT, ANT_RIGHT);
        worst(&feed->moved[0], task->theta[k] - feed->x[k][0]);
    }
    for (int k = 0; k < n; k++) {
        ant_real *x = feed->x[k], *y = feed->y[k];
        const ant_real theta = x[0], omega = derivative(ANT_D1[k], feed), alpha = derivative(ANT_D2[k], feed);
        const ant_real T = ANT_INERTIA * alpha + ANT_DAMPING * omega + ANT_GRAVITY * ANT_F(sin)(theta) - task->d[k];
        ant_target target = ant_target_of(theta, task->K[k], T);
        target.min_force = min_force;
        const ant_allocation held = ant_allocate(&target);
        x[1] = omega, x[2] = held.P1, x[3] = held.P2;
        y[0] = held.K, y[1] = y[2] = 0;
        feed->finite = feed->finite && held.status >= 0;
        worst(&feed->moved[1], task->K[k] - held.K);
        worst(&feed->moved[2], T - held.T);
    }
    ant_real q[2], last[2];
    ant_model_expansion(feed->x[0], q);
    for (int k = 0; k < ANT_HORIZON; k++) {
        for (int i = 0; i < 2; i++) last[i] = q[i];
        ant_model_expansion(feed->x[k + 1], q);
        for (int i = 0; i < 2; i++)
            feed->u[k][i] = (feed->x[k + 1][2 + i] - ANT_KEPT[i] * feed->x[k][2 + i]) / (1 - ANT_KEPT[i]) +
                            ANT_LAG[i] / 2 * (q[i] + last[i]);
    }
}
