/* From the joint's motion under the previous plan to least squares in the changes of its commands: with dx_0 = 0
 *
 *     dx_{k+1} = A_k dx_k + B_k E_k z      so      x_k = x'_k + G_k z,   G_0 = 0,   G_{k+1} = A_k G_k + B_k E_k
 *
 * where E_k z [Pa] is the sum of the changes up to sample k, and every entry of the rows x, y, e and rate that the cost
 * charges for is |root (row z + r)|^2/2, their roots being those of the weights. */
#include <string.h>

#include "control.h"
#include "model.h"
#include "tables.h"

/* How many of the moves act at sample k. */
static int acting(int k) { return 2 * ANT_ACTING[k]; }

/* G_{k+1} from G_k (NULL: zero). */
static void unroll(const ant_real A[4][4], const ant_real B[4][2], const ant_real (*G)[ANT_MOVES], int k,
                   ant_real (*next)[ANT_MOVES]) {
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < ANT_MOVES; j++) {
            ant_real sum = j < acting(k) ? ANT_BAR * B[i][j % 2] : 0;
            for (int l = 0; l < 4 && G != NULL; l++) sum += A[i][l] * G[l][j];
            next[i][j] = sum;
        }
}

/* G for the motion of z = 0. */
static void linearise(ant_qp *qp, const ant_real *d) {
    for (int k = 0; k < ANT_HORIZON; k++) {
        ant_real A[4][4], B[4][2];
        ant_model_slopes(qp->motion.x[k], qp->motion.u[k], &d[k], A[0], B[0]);
        unroll((const ant_real(*)[4])A, (const ant_real(*)[2])B,
               k > 0 ? (const ant_real(*)[ANT_MOVES])qp->G[k - 1] : NULL, k, qp->G[k]);
    }
}

/* A term of the cost on which the first `used` moves have an effect; the later terms come later. */
static void add(ant_qp *qp, int used, ant_real root, ant_real row[ANT_MOVES], ant_real r) {
    for (int j = 0; j < used; j++) row[j] *= root;
    ant_rotate_in(ANT_MOVES, used, qp->R, qp->v, row, root * r);
}

/* gradient G: what the moves do to something that depends on the state. */
static void through(const ant_real gradient[4], const ant_real (*G)[ANT_MOVES], ant_real row[ANT_MOVES]) {
    for (int j = 0; j < ANT_MOVES; j++)
        row[j] = gradient[0] * G[0][j] + gradient[1] * G[1][j] + gradient[2] * G[2][j] + gradient[3] * G[3][j];
}

/* The rows of state and outputs at sample k + 1, and the forces' sensitivity there. */
static void add_state(ant_qp *qp, const ant_feed *feed, int k) {
    ant_real row[ANT_MOVES], slope[3][4]; /* of y = (K, F1, F2) */
    const ant_motion *m = &qp->motion;
    const ant_real *x = m->x[k + 1], y[3] = {m->K[k + 1], m->F[k + 1][0], m->F[k + 1][1]};
    const ant_real(*G)[ANT_MOVES] = (const ant_real(*)[ANT_MOVES])qp->G[k];
    ant_model_gradients(x, slope[0], slope[1]);
    for (int i = 0; i < 2; i++) through(slope[1 + i], G, qp->GF[k][i]);
    if (k + 1 == ANT_HORIZON) return; /* the last state is the terminal cost's */
    for (int i = 0; i < 4; i++) {
        if (!(ANT_ROOT_X[i] > 0)) continue;
        memcpy(row, G[i], sizeof row);
        add(qp, acting(k), ANT_ROOT_X[i], row, x[i] - feed->x[k + 1][i]);
    }
    for (int i = 0; i < 3; i++) {
        if (!(ANT_ROOT_Y[i] > 0)) continue;
        through(slope[i], G, row);
        add(qp, acting(k), ANT_ROOT_Y[i], row, y[i] - feed->y[k + 1][i]);
    }
}

/* The rates of the commands away from the feed-forward: of what begins at sample k only its own move changes them. */
static void begin_with_rates(ant_qp *qp, const ant_feed *feed, const ant_real e_last[2]) {
    memset(qp->R, 0, sizeof qp->R);
    for (int b = 0; b < ANT_BLOCKS; b++)
        for (int i = 0; i < 2; i++) {
            const int k = ANT_STARTS[b], j = 2 * b + i;
            const ant_real root = ANT_ROOT_RATE[i] / ANT_DT, e = qp->motion.u[k][i] - feed->u[k][i];
            const ant_real previous = k > 0 ? qp->motion.u[k - 1][i] - feed->u[k - 1][i] : e_last[i];
            qp->R[ant_at(ANT_MOVES, j) + j] = root * ANT_BAR;
            qp->v[j] = root * (e - previous);
        }
}

/* Commands away from the feed-forward. */
static void add_commands(ant_qp *qp, const ant_feed *feed, int k) {
    for (int i = 0; i < 2; i++) {
        ant_real row[ANT_MOVES];
        for (int j = 0; j < acting(k); j++) row[j] = j % 2 == i ? ANT_BAR : 0;
        add(qp, acting(k), ANT_ROOT_E[i], row, qp->motion.u[k][i] - feed->u[k][i]);
    }
}

/* |L xi|^2/2, xi = (x_N - x*_N, e_{N-1}). */
static void add_terminal(ant_qp *qp, const ant_feed *feed) {
    enum { last = ANT_HORIZON };
    ant_real xi[6];
    for (int i = 0; i < 4; i++) xi[i] = qp->motion.x[last][i] - feed->x[last][i];
    for (int i = 0; i < 2; i++) xi[4 + i] = qp->motion.u[last - 1][i] - feed->u[last - 1][i];
    for (int m = 0; m < 6; m++) {
        ant_real row[ANT_MOVES], r = 0;
        for (int l = 0; l < 6; l++) r += ANT_TERMINAL[m][l] * xi[l];
        for (int j = 0; j < ANT_MOVES; j++) {
            row[j] = ANT_BAR * ANT_TERMINAL[m][4 + j % 2];
            for (int l = 0; l < 4; l++) row[j] += ANT_TERMINAL[m][l] * qp->G[last - 1][l][j];
        }
        add(qp, ANT_MOVES, 1, row, r);
    }
}

/* The slew: each move is at most a step, and z = 0 is allowed whatever rounding says. */
static void slew_bounds(ant_qp *qp, const ant_real u_last[2]) {
    for (int b = 0; b < ANT_BLOCKS; b++)
        for (int i = 0; i < 2; i++) {
            const int k = ANT_STARTS[b];
            const ant_real change = qp->motion.u[k][i] - (k > 0 ? qp->motion.u[k - 1][i] : u_last[i]);
            const ant_real lower = (-ANT_STEP - change) / ANT_BAR, upper = (ANT_STEP - change) / ANT_BAR;
            qp->lower[2 * b + i] = lower < 0 ? lower : 0;
            qp->upper[2 * b + i] = upper > 0 ? upper : 0;
        }
}

int ant_condense(ant_controller *c, const ant_task *task, const ant_real u_last[2]) {
    ant_qp *qp = &c->qp;
    const ant_real *star = c->starred ? c->u_star : c->feed.u[0];
    const ant_real e_last[2] = {u_last[0] - star[0], u_last[1] - star[1]};
    if (!ant_rollout(task->x, task->d, &qp->motion) || !c->feed.finite) return 0;
    linearise(qp, task->d);
    begin_with_rates(qp, &c->feed, e_last);
    for (int k = 0; k < ANT_HORIZON; k++) {
        add_state(qp, &c->feed, k);
        add_commands(qp, &c->feed, k);
    }
    add_terminal(qp, &c->feed);
    slew_bounds(qp, u_last);
    return ant_finite(qp->R, ANT_TRIANGLE(ANT_MOVES)) && ant_finite(qp->v, ANT_MOVES);
}
