/* The exact allocation of one target: invalid targets are refused, the kernel answers the others. */
#include "exact.h"
#include "joint.h"
#include "real.h"

ant_target ant_target_of(ant_real theta, ant_real K, ant_real T) {
    const ant_target target = {theta, K, T, 0, ANT_INFINITY, 0, 0, ANT_INFINITY, ANT_TORQUE_FIRST};
    return target;
}

static int sensible(const ant_target *t) {
    const int numbers = isfinite(t->theta) && isfinite(t->K) && isfinite(t->T);
    const int forces = (t->min_force >= 0 || isinf(t->min_force)) && t->max_force > 0 && t->max_force > t->min_force;
    const int steps = isfinite(t->P1_now) && isfinite(t->P2_now) && t->max_step > 0;
    const int known = t->priority == ANT_TORQUE_FIRST || t->priority == ANT_STIFFNESS_FIRST;
    return numbers && forces && steps && known && ant_abs(t->theta) <= 2 * ANT_PI && t->K > 0;
}

/* The present pressures, or the least ones, as far as they are valid: the answer to an invalid target. */
static ant_allocation refusal(const ant_target *t, ant_status status) {
    const int now = t->max_step < ANT_INFINITY && isfinite(t->P1_now) && isfinite(t->P2_now);
    ant_allocation a = {ANT_SUPPLY_LO, ANT_SUPPLY_LO, 0, 0, ANT_BAD_INPUT, 0};
    a.status = status;
    if (now) {
        a.P1 = ant_clip(t->P1_now, ANT_SUPPLY_LO, ANT_HI1);
        a.P2 = ant_clip(t->P2_now, ANT_SUPPLY_LO, ANT_HI2);
    }
    return a;
}

ant_allocation ant_allocate(const ant_target *t) {
    if (!sensible(t)) return refusal(t, ANT_BAD_INPUT);
    const ant_answer found = ant_exact(t);
    if (!found.sure) return refusal(t, ANT_BEYOND_MODEL);
    ant_allocation a = {found.P1, found.P2, found.T_given, found.K_given, ANT_EXACT, found.limits};
    a.status = (ant_status)found.status;
    return a;
}
