/* A step that always has an answer, found in another way than the QP's:
 *
 *     minimise   |R z + v|^2/2 + sum of charge_i max(0, breach_i(z))^2/2     over    lower <= z <= upper
 *
 * Of the limits only the slew is hard. Bounded least squares, each charging the rows that the last one broke, until
 * they repeat. What counts is the best point met: it is allowed, and better than to go on with z = 0. */
#include <string.h>

#include "control.h"

enum { n = ANT_MOVES, CHANGES = 4 * ANT_MOVES };

static ant_real cost(const ant_qp *qp, const ant_real z[ANT_DECISIONS]) {
    ant_real sum = ant_cost(n, qp->work.dense.R, qp->work.dense.v, z);
    for (int i = 0; i < ANT_ROWS; i++) {
        const ant_real breach = ant_breach(qp, i, z);
        if (breach > 0) sum += ant_charge(i) / 2 * breach * breach;
    }
    return sum;
}

/* The QP's least squares with the rows that are charged: |row z - b|, b being the limit that z breaks. */
static void charge(const ant_qp *qp, ant_softened *s, const ant_real z[ANT_DECISIONS]) {
    memcpy(s->R, qp->work.dense.R, sizeof s->R);
    memcpy(s->v, qp->work.dense.v, sizeof s->v);
    for (int i = 0; i < ANT_ROWS; i++) {
        if (!s->charged[i]) continue;
        ant_valued_row at = ant_row_at(qp, ANT_DECISIONS + i, z); /* z has no slacks */
        const ant_real root = ANT_F(sqrt)(ant_charge(i));
        for (int j = 0; j < n; j++) at.row[j] *= root;
        ant_rotate_in(n, n, s->R, s->v, at.row, -root * ant_clip(at.value, at.lower, at.upper));
    }
}

/* The minimum on the face where the decisions on a side stay: least squares in the others. */
static void solve_face(ant_softened *s, const ant_real z[n], ant_real target[n]) {
    int free = 0;
    for (int j = 0; j < n; j++) free += s->side[j] == 0;
    memset(s->face_R, 0, sizeof s->face_R);
    memset(s->face_v, 0, sizeof s->face_v);
    for (int i = 0; i < n; i++) {
        const ant_real *Ri = s->R + ant_at(n, i);
        ant_real row[n] = {0}, r = s->v[i];
        for (int j = 0, f = 0; j < n; j++) {
            const ant_real element = j < i ? 0 : Ri[j];
            if (s->side[j] == 0)
                row[f++] = element;
            else
                r += element * z[j];
        }
        ant_rotate_in(free, free, s->face_R, s->face_v, row, r);
    }
    memcpy(target, z, n * sizeof target[0]);
    for (int j = n - 1, f = free - 1; j >= 0; j--) {
        if (s->side[j] != 0) continue;
        const ant_real *Rf = s->face_R + ant_at(free, f);
        ant_real sum = s->face_v[f];
        for (int l = j + 1, m = f + 1; l < n; l++)
            if (s->side[l] == 0) sum += Rf[m++] * target[l];
        target[j] = -sum / Rf[f];
        f--;
    }
}

/* From z towards the target, up to the first bound met, where that decision is held; whether one was. */
static int go(const ant_qp *qp, ant_softened *s, ant_real z[n], const ant_real target[n]) {
    ant_real share = 1;
    int met = -1;
    for (int j = 0; j < n; j++) {
        const ant_real bound = target[j] < qp->work.dense.lower[j]   ? qp->work.dense.lower[j]
                               : target[j] > qp->work.dense.upper[j] ? qp->work.dense.upper[j]
                                                          : target[j];
        if (s->side[j] != 0 || bound == target[j]) continue;
        if (met < 0 || (bound - z[j]) / (target[j] - z[j]) < share) {
            share = (bound - z[j]) / (target[j] - z[j]);
            met = j;
        }
    }
    for (int j = 0; j < n; j++) z[j] += share * (target[j] - z[j]);
    if (met < 0) return 0;
    s->side[met] = target[met] < qp->work.dense.lower[met] ? -1 : 1;
    z[met] = s->side[met] < 0 ? qp->work.dense.lower[met] : qp->work.dense.upper[met];
    return 1;
}

/* Lets go of the decision that most wants to leave its bound; whether one does. */
static int release(ant_softened *s, const ant_real z[n]) {
    ant_real gradient[n] = {0}, most = 0;
    int which = -1;
    for (int i = 0; i < n; i++) {
        const ant_real *Ri = s->R + ant_at(n, i);
        ant_real residual = s->v[i];
        for (int j = i; j < n; j++) residual += Ri[j] * z[j];
        for (int j = i; j < n; j++) gradient[j] += Ri[j] * residual;
    }
    for (int j = 0; j < n; j++)
        if (s->side[j] * gradient[j] > most) {
            most = s->side[j] * gradient[j];
            which = j;
        }
    if (which >= 0) s->side[which] = 0;
    return which >= 0;
}

/* Bounded least squares by an active set, from z = 0. */
static void minimise(const ant_qp *qp, ant_softened *s, ant_real z[n]) {
    memset(s->side, 0, sizeof s->side);
    memset(z, 0, n * sizeof z[0]);
    for (int change = 0; change < CHANGES; change++) {
        ant_real target[n];
        solve_face(s, z, target);
        if (!go(qp, s, z, target) && !release(s, z)) return;
    }
}

int ant_soften(ant_controller *c, ant_real best[ANT_DECISIONS]) {
    ant_softened *s = &c->qp.work.dense.work.softened;
    ant_real z[ANT_DECISIONS] = {0}, least = cost(&c->qp, z);
    int found = 0;
    memset(s->charged, 0, sizeof s->charged);
    for (int round = 0; round < ANT_ROUNDS; round++) {
        charge(&c->qp, s, z);
        minimise(&c->qp, s, z);
        const ant_real price = cost(&c->qp, z);
        if (price < least) {
            least = price;
            memcpy(best, z, sizeof z);
            found = 1;
        }
        memcpy(s->was, s->charged, sizeof s->was);
        for (int i = 0; i < ANT_ROWS; i++) s->charged[i] = ant_breach(&c->qp, i, z) > 0;
        if (memcmp(s->was, s->charged, sizeof s->was) == 0) break;
    }
    return found;
}
