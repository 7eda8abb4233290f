/* One target: converted to least squares, solved by the kernel, and its status computed from the pressures. */
#include "mechanism.h"
#include "model.h"
#include "real.h"
#include "target.h"

/* Fill in the map y0 + M P and the box; return the status that a muscle or the posture gives, ANT_EXACT for none. */
static ant_status at_posture(const ant_target *t, ant_memory *o) {
    ant_real q[ANT_JOINTS], eps[ANT_MUSCLES], gain[ANT_MUSCLES], force[ANT_MUSCLES];
    int outside = 0, status = ANT_EXACT, unreachable = 0;
    for (int i = 0; i < ANT_JOINTS; i++) {
        q[i] = ant_clip(t->q[i], ANT_LEFT[i], ANT_RIGHT[i]);
        outside = outside || !ant_equal(q[i], t->q[i]);
    }
    ant_model_mechanism(q, eps, gain, force, o->y0, &o->M[0][0]);
    for (int j = 0; j < ANT_MUSCLES; j++) {
        const ant_real bounds[6] = {ANT_SUPPLY_LO,
                                    ANT_HI[j],
                                    isinf(t->min_force) ? -ANT_INFINITY : (t->min_force - force[j]) / gain[j],
                                    isinf(t->max_force) ? ANT_INFINITY : (t->max_force - force[j]) / gain[j],
                                    t->P_now[j] - t->max_step,
                                    t->P_now[j] + t->max_step};
        const ant_bounds found = ant_interval(bounds, ANT_NEAR);
        o->lo[j] = found.low / ANT_UNIT;
        o->hi[j] = found.high / ANT_UNIT;
        o->centre[j] = t->nearest ? t->P_now[j] / ANT_UNIT : 0;
        unreachable = unreachable || found.status == ANT_OUTSIDE_LIMITS;
        if (found.status > status) status = found.status;
        outside = outside || eps[j] < ANT_LEAST_CONTRACTION;
    }
    if (unreachable) return ANT_OUTSIDE_LIMITS;
    return outside ? ANT_OUTSIDE_JOINT_RANGE : (ant_status)status;
}

/* Fill in the rows, level after level; an entry that is free has a row of zeros. */
static void rows(const ant_target *t, ant_memory *o) {
    const int torque_first = t->priority == ANT_TORQUE_FIRST;
    for (int i = 0; i < ANT_JOINTS; i++) o->y[i] = t->T[i];
    for (int i = 0; i < ANT_STIFFNESSES; i++) o->y[ANT_JOINTS + i] = t->K[i];
    for (int i = 0; i < ANT_ROWS; i++) {
        const int row = torque_first                     ? i
                        : i < ANT_JOINTS                 ? i + ANT_STIFFNESSES
                                                         : i - ANT_JOINTS;
        const ant_real weight = isnan(o->y[i]) ? 0 : ANT_WEIGHT[i];
        o->b[row] = isnan(o->y[i]) ? 0 : weight * (o->y[i] - o->y0[i]);
        for (int j = 0; j < ANT_MUSCLES; j++) o->A[row][j] = weight * ANT_UNIT * o->M[i][j];
        o->onesided[row] = 0;
    }
    o->ends[0] = torque_first ? ANT_JOINTS : ANT_STIFFNESSES;
    o->ends[1] = ANT_ROWS;
}

/* The status of pressures that give a->T and a->K: the missed target, unless a posture or a muscle has a graver one. */
static ant_status judged(const ant_memory *o, const ant_allocation *a, ant_status given) {
    int missed = ANT_EXACT;
    for (int i = 0; i < ANT_ROWS; i++) {
        ant_real scale = ant_abs(o->y0[i]) + ant_abs(o->y[i]);
        for (int j = 0; j < ANT_MUSCLES; j++) scale += ant_abs(o->M[i][j] * o->hi[j]) * ANT_UNIT;
        if (ant_abs(o->given[i] - o->y[i]) > ANT_MET * scale) {
            missed |= i < ANT_JOINTS ? ANT_TORQUE_LIMITED : ANT_STIFFNESS_LIMITED;
        }
    }
    const int status = ant_positive_definite(a->K) ? missed : ANT_UNSTABLE;
    if (given == ANT_OUTSIDE_LIMITS) return given;
    if (!(a->residual <= ANT_TRUSTED)) return ANT_SOLVER_FAILED;
    return given != ANT_EXACT ? given : (ant_status)status;
}

void ant_allocate(const ant_target *t, ant_memory *o, ant_allocation *a) {
    if (!ant_sensible(t)) {
        ant_refuse(t, a);
        return;
    }
    const ant_status given = at_posture(t, o);
    rows(t, o);
    const ant_levels levels = {(const ant_real(*)[ANT_MUSCLES])o->A, o->b, o->onesided, o->ends};
    const ant_box box = {o->lo, o->hi, o->centre};
    ant_kernel_prepare(&levels, &o->work);
    a->rounds = ant_kernel_solve(&levels, &box, o->x, o->side, o->mu, t->follow && o->solved, &o->work);
    o->solved = a->rounds > 0;
    for (int j = 0; j < ANT_MUSCLES; j++) {
        o->x[j] = ant_clip(o->x[j], o->lo[j], o->hi[j]);
        a->P[j] = ant_clip(o->x[j] * ANT_UNIT, o->lo[j] * ANT_UNIT, o->hi[j] * ANT_UNIT);
    }
    for (int i = 0; i < ANT_ROWS; i++) {
        o->given[i] = o->y0[i];
        for (int j = 0; j < ANT_MUSCLES; j++) o->given[i] += o->M[i][j] * a->P[j];
    }
    for (int i = 0; i < ANT_JOINTS; i++) a->T[i] = o->given[i];
    for (int i = 0; i < ANT_STIFFNESSES; i++) a->K[i] = o->given[ANT_JOINTS + i];
    a->residual = ant_kernel_residual(&levels, &box, o->x, o->mu, 0, ANT_BINDS, o->held, &o->work);
    a->status = judged(o, a, given);
}
