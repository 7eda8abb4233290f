/* From the joint's motion under the previous plan to least squares in the changes of its commands: with dx_0 = 0
 *
 *     dx_{k+1} = A_k dx_k + B_k E_k z      so      x_k = x'_k + G_k z,   G_0 = 0,   G_{k+1} = A_k G_k + B_k E_k
 *
 * where E_k z [Pa] is the sum of the changes up to sample k, and every entry of the rows x, y, e and rate that the cost
 * charges for is |root (row z + r)|^2/2, their roots being those of the weights. */
#include <string.h>

#include "dense.h"
#include "tables.h"

/* How many of the moves act at sample k. */
static int acting(int k) { return 2 * ANT_ACTING[k]; }

/* G_{k+1} from G_k. */
static void unroll(ant_qp *qp, int k) {
    const ant_real(*G)[ANT_MOVES] = (const ant_real(*)[ANT_MOVES])qp->work.dense.work.G[k % 2];
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < ANT_MOVES; j++) {
            ant_real sum = j < acting(k) ? qp->B[k][i][j % 2] : 0;
            for (int l = 0; l < 4 && k > 0; l++) sum += qp->A[k][i][l] * G[l][j];
            qp->work.dense.work.G[(k + 1) % 2][i][j] = sum;
        }
}

/* A term of the cost on which the first `used` moves have an effect; the later terms come later. */
static void add(ant_qp *qp, int used, ant_real root, ant_real row[ANT_MOVES], ant_real r) {
    for (int j = 0; j < used; j++) row[j] *= root;
    ant_rotate_in(ANT_MOVES, used, qp->work.dense.R, qp->work.dense.v, row, root * r);
}

/* gradient G: derivative by the moves of a function of the state. */
static void through(const ant_real gradient[4], const ant_real (*G)[ANT_MOVES], ant_real row[ANT_MOVES]) {
    for (int j = 0; j < ANT_MOVES; j++)
        row[j] = gradient[0] * G[0][j] + gradient[1] * G[1][j] + gradient[2] * G[2][j] + gradient[3] * G[3][j];
}

/* The rows of state and outputs at sample k + 1; the last state is the terminal cost's. */
static void add_state(ant_qp *qp, const ant_feed *feed, int k) {
    ant_real row[ANT_MOVES];
    const ant_real(*G)[ANT_MOVES] = (const ant_real(*)[ANT_MOVES])qp->work.dense.work.G[(k + 1) % 2];
    for (int i = 0; i < 4; i++) {
        if (!(qp->tuning->root_x[i] > 0)) continue;
        memcpy(row, G[i], sizeof row);
        add(qp, acting(k), qp->tuning->root_x[i], row, qp->motion.x[k + 1][i] - feed->x[k + 1][i]);
    }
    for (int i = 0; i < 3; i++) {
        if (!(qp->tuning->root_y[i] > 0)) continue;
        through(qp->slope[k + 1][i], G, row);
        add(qp, acting(k), qp->tuning->root_y[i], row, qp->y[k + 1][i] - feed->y[k + 1][i]);
    }
}

/* Rates of the commands relative to the feed-forward: those at sample k depend on the move that begins there. */
static void begin_with_rates(ant_qp *qp, const ant_feed *feed, const ant_real e_last[2]) {
    memset(qp->work.dense.R, 0, sizeof qp->work.dense.R);
    for (int b = 0; b < ANT_BLOCKS; b++)
        for (int i = 0; i < 2; i++) {
            const int k = ANT_STARTS[b], j = 2 * b + i;
            const ant_real root = qp->tuning->root_rate[i] / ANT_DT, e = qp->motion.u[k][i] - feed->u[k][i];
            const ant_real previous = k > 0 ? qp->motion.u[k - 1][i] - feed->u[k - 1][i] : e_last[i];
            qp->work.dense.R[ant_at(ANT_MOVES, j) + j] = root * ANT_BAR;
            qp->work.dense.v[j] = root * (e - previous);
        }
}

/* Commands away from the feed-forward. */
static void add_commands(ant_qp *qp, const ant_feed *feed, int k) {
    for (int i = 0; i < 2; i++) {
        ant_real row[ANT_MOVES];
        for (int j = 0; j < acting(k); j++) row[j] = j % 2 == i ? ANT_BAR : 0;
        add(qp, acting(k), qp->tuning->root_e[i], row, qp->motion.u[k][i] - feed->u[k][i]);
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
        for (int l = 0; l < 6; l++) r += qp->tuning->terminal[m][l] * xi[l];
        for (int j = 0; j < ANT_MOVES; j++) {
            row[j] = ANT_BAR * qp->tuning->terminal[m][4 + j % 2];
            for (int l = 0; l < 4; l++) row[j] += qp->tuning->terminal[m][l] * qp->work.dense.work.G[last % 2][l][j];
        }
        add(qp, ANT_MOVES, 1, row, r);
    }
}

int ant_condense(ant_controller *c, const ant_real u_last[2]) {
    ant_qp *qp = &c->qp;
    const ant_real *star = c->starred ? c->u_star : c->feed.u[0];
    const ant_real e_last[2] = {u_last[0] - star[0], u_last[1] - star[1]};
    begin_with_rates(qp, &c->feed, e_last);
    for (int k = 0; k < ANT_HORIZON; k++) {
        unroll(qp, k);
        if (k + 1 < ANT_HORIZON) add_state(qp, &c->feed, k);
        add_commands(qp, &c->feed, k);
    }
    add_terminal(qp, &c->feed);
    for (int b = 0; b < ANT_BLOCKS; b++) {
        memcpy(qp->work.dense.lower + 2 * b, qp->lower[ANT_STARTS[b]], sizeof qp->lower[0]);
        memcpy(qp->work.dense.upper + 2 * b, qp->upper[ANT_STARTS[b]], sizeof qp->upper[0]);
    }
    return ant_finite(qp->work.dense.R, ANT_TRIANGLE(ANT_MOVES)) && ant_finite(qp->work.dense.v, ANT_MOVES);
}
