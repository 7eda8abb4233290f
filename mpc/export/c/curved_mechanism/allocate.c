/* One target of muscles that are not affine in the pressure: pressures near the best that there are, and a proof of how
 * near. As in Python's relaxation/search.py. */
#include "curved.h"
#include "mechanism.h"
#include "model.h"
#include "real.h"
#include "target.h"

enum { DESCENT_STEPS = 100, STARTS = 5 };

#define START_BESIDE ANT_R(0.35) /* of the interval of a muscle's pressure, from its middle */

/* Fill in what the routes and the limits leave; return the status that a muscle or the posture gives, ANT_EXACT for none. */
static ant_status at_posture(const ant_target *t, ant_memory *o) {
    ant_real q[ANT_JOINTS];
    int outside = 0, status = ANT_EXACT, unreachable = 0;
    for (int i = 0; i < ANT_JOINTS; i++) {
        q[i] = ant_clip(t->q[i], ANT_LEFT[i], ANT_RIGHT[i]);
        outside = outside || q[i] != t->q[i];
    }
    ant_model_routes(q, o->eps, &o->arm[0][0], &o->bend[0][0]);
    for (int j = 0; j < ANT_MUSCLES; j++) {
        const ant_real bounds[6] = {ANT_SUPPLY_LO,
                                    ANT_HI[j],
                                    isinf(t->min_force) ? -ANT_INFINITY : ant_pressure(o, j, t->min_force),
                                    isinf(t->max_force) ? ANT_INFINITY : ant_pressure(o, j, t->max_force),
                                    t->P_now[j] - t->max_step,
                                    t->P_now[j] + t->max_step};
        const ant_bounds found = ant_interval(bounds, ANT_NEAR);
        o->lo[j] = found.low;
        o->hi[j] = found.high;
        unreachable = unreachable || found.status == ANT_OUTSIDE_LIMITS;
        if (found.status > status) status = found.status;
        outside = outside || o->eps[j] < ANT_LEAST_CONTRACTION;
    }
    if (unreachable) return ANT_OUTSIDE_LIMITS;
    return outside ? ANT_OUTSIDE_JOINT_RANGE : (ant_status)status;
}

static int missed(const ant_memory *o, int k) {
    for (int i = o->ends[k]; i < o->ends[k + 1]; i++) {
        if (!(ant_abs(o->best.left[i]) <= ANT_MET * o->scale[k])) return 1;
    }
    return 0;
}

/* Where a descent begins: in the middle, and beside it, muscles in turn high and low. */
static ant_real start(const ant_memory *o, int which, int j) {
    const ant_real in_turn = j % 2 ? ANT_R(1.0) : ANT_R(-1.0);
    const ant_real pattern = which == 0 || (which > 2 && j < ANT_MUSCLES - 2) ? 0 : which % 2 ? in_turn : -in_turn;
    return (o->lo[j] + o->hi[j]) / 2 + START_BESIDE * (o->hi[j] - o->lo[j]) * pattern;
}

static void descended(const ant_target *t, ant_memory *o) {
    if (t->follow && o->solved) {
        for (int j = 0; j < ANT_MUSCLES; j++) o->best.P[j] = ant_clip(o->best.P[j], o->lo[j], o->hi[j]);
        ant_descend(o, &o->best, DESCENT_STEPS);
        if (!missed(o, 0) && !missed(o, 1)) return;
    }
    for (int which = 0; which < STARTS; which++) {
        for (int j = 0; j < ANT_MUSCLES; j++) o->tried.P[j] = start(o, which, j);
        ant_descend(o, &o->tried, DESCENT_STEPS);
        if (which == 0 || ant_lower(o, &o->tried, &o->best, ANT_CHANGES)) o->best = o->tried;
    }
}

/* Branch where a level is missed; fill in bounds, nodes and the gap that is left. */
static void closed(const ant_target *t, ant_memory *o, ant_allocation *a) {
    a->bounds[0] = a->bounds[1] = a->gap = 0;
    for (int k = 0; k < 2; k++) {
        if (!missed(o, k)) continue;
        const ant_real before = o->best.costs[k];
        if (o->rising && o->seen) a->bounds[k] = ant_close(o, k, t->gap, t->nodes, &a->rounds);
        if (o->best.costs[k] < before) ant_descend(o, &o->best, DESCENT_STEPS);
    }
    for (int k = 0; k < 2; k++) {
        const ant_real cost = o->best.costs[k], left = missed(o, k) ? (cost - a->bounds[k]) / (1 + cost) : 0;
        if (!(left <= a->gap)) a->gap = left;
    }
}

/* Fill in torques and stiffness, and the status: what is missed, unless there is something graver. */
static void judged(const ant_target *t, const ant_memory *o, ant_status given, ant_allocation *a) {
    ant_real y[ANT_ROWS] = {0}, scale[ANT_ROWS] = {0}, asked[ANT_ROWS];
    for (int i = 0; i < ANT_JOINTS; i++) asked[i] = t->T[i];
    for (int i = 0; i < ANT_STIFFNESSES; i++) asked[ANT_JOINTS + i] = t->K[i];
    for (int j = 0; j < ANT_MUSCLES; j++) {
        const ant_state s = ant_at(o, j, a->P[j]), high = ant_at(o, j, o->hi[j]);
        int row = ANT_JOINTS;
        for (int i = 0; i < ANT_JOINTS; i++) {
            y[i] += o->arm[j][i] * s.F;
            scale[i] += ant_abs(o->arm[j][i] * high.F);
            for (int c = i; c < ANT_JOINTS; c++, row++) {
                const ant_real square = o->arm[j][i] * o->arm[j][c], bend = o->bend[j][row - ANT_JOINTS];
                y[row] += square * s.k + bend * s.F;
                scale[row] += ant_abs(square * high.k + bend * high.F);
            }
        }
    }
    int status = ANT_EXACT;
    for (int i = 0; i < ANT_ROWS; i++) {
        if (ant_abs(y[i] - asked[i]) > ANT_MET * (scale[i] + ant_abs(asked[i]))) {
            status |= i < ANT_JOINTS ? ANT_TORQUE_LIMITED : ANT_STIFFNESS_LIMITED;
        }
    }
    for (int i = 0; i < ANT_JOINTS; i++) a->T[i] = y[i];
    for (int i = 0; i < ANT_STIFFNESSES; i++) a->K[i] = y[ANT_JOINTS + i];
    if (!ant_positive_definite(a->K)) status = ANT_UNSTABLE;
    if (given != ANT_EXACT) status = given;
    if (given != ANT_OUTSIDE_LIMITS && !(o->rising && a->gap <= t->gap)) status = ANT_SOLVER_FAILED;
    a->status = (ant_status)status;
}

void ant_allocate(const ant_target *t, ant_memory *o, ant_allocation *a) {
    a->gap = a->bounds[0] = a->bounds[1] = 0;
    if (!ant_sensible(t) || !(t->gap > 0 && t->gap < 1)) {
        ant_refuse(t, a);
        return;
    }
    const ant_status given = at_posture(t, o);
    ant_pose(t, o);
    ant_look_at_curves(o);
    a->rounds = 0;
    descended(t, o);
    closed(t, o, a);
    for (int j = 0; j < ANT_MUSCLES; j++) a->P[j] = o->best.P[j] = ant_clip(o->best.P[j], o->lo[j], o->hi[j]);
    ant_worth(o, &o->best);
    a->residual = ant_certified(o, &o->best);
    judged(t, o, given, a);
    o->solved = a->status != ANT_SOLVER_FAILED;
}
