/* The exact allocation of one target: box, lexicographic optimum, judgement.
 *
 * Nothing is searched: the first target is brought into its interval, both ends of its level in the box are found, the
 * second target is brought between them, and the muscles' law (law.c) is inverted.
 */
#include "law.h"
#include "real.h"

/* Limit flags of a muscle. */
typedef struct {
    int lower, upper, slack, force, rate;
} flags;

static const flags AGONIST = {ANT_P1_LOWER, ANT_HI1_LIMIT, ANT_AGONIST_SLACK, ANT_AGONIST_FORCE, ANT_P1_RATE};
static const flags ANTAGONIST = {ANT_P2_LOWER, ANT_HI2_LIMIT, ANT_ANTAGONIST_SLACK, ANT_ANTAGONIST_FORCE, ANT_P2_RATE};
static const ant_real NEAR = ANT_NEAR * (ANT_SUPPLY_HI - ANT_SUPPLY_LO); /* to a limit: on it */

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

/* Supply and validity, least and greatest force, slew. Moving is a hard limit: from outside the nearest in reach
 * remains. */
static ant_interval interval(const ant_target *t, ant_real most, ant_real taut, ant_real ceiling, ant_real now) {
    ant_interval i = {0, 0, -ANT_INFINITY, ANT_INFINITY, now - t->max_step, now + t->max_step, ANT_EXACT};
    if (t->min_force > -ANT_INFINITY) i.taut = taut;
    if (t->max_force < ANT_INFINITY) i.ceiling = ceiling;
    most = ant_clip(i.ceiling, ANT_SUPPLY_LO, most);
    i.lo = ant_clip(ant_clip(i.taut, ANT_SUPPLY_LO, most), i.nearest, i.farthest);
    i.hi = ant_clip(most, i.nearest, i.farthest);
    if (i.taut > most + NEAR || i.ceiling < ANT_SUPPLY_LO - NEAR) i.status = ANT_CONFLICT;
    if (i.taut > i.hi + NEAR) i.status = ANT_SLACK;
    if (i.nearest > most + NEAR || i.farthest < ANT_SUPPLY_LO - NEAR) i.status = ANT_OUTSIDE_LIMITS;
    return i;
}

static ant_box box_at(const ant_law *law, const ant_target *t) {
    const ant_real low = t->min_force > -ANT_INFINITY ? t->min_force : 0;
    const ant_real high = t->max_force < ANT_INFINITY ? t->max_force : 0;
    const ant_real taut1 = ant_law_pressure(law, 0, low), ceiling1 = ant_law_pressure(law, 0, high);
    const ant_real taut2 = ant_law_pressure(law, 1, low), ceiling2 = ant_law_pressure(law, 1, high);
    const ant_box box = {interval(t, ANT_HI1, taut1, ceiling1, t->P1_now),
                         interval(t, ANT_HI2, taut2, ceiling2, t->P2_now)};
    return box;
}

static int on(ant_real P, ant_real limit) { return ant_abs(P - limit) <= NEAR; }

/* The flags of the limits that P lies on. */
static int binding(ant_real P, const ant_interval *i, ant_real most, flags flag) {
    return (on(P, ANT_SUPPLY_LO) ? flag.lower : 0) | (on(P, most) ? flag.upper : 0) |
           (on(P, i->taut) ? flag.slack : 0) | (on(P, i->ceiling) ? flag.force : 0) |
           (on(P, i->nearest) || on(P, i->farthest) ? flag.rate : 0);
}

/* What is large: both muscles' torque and stiffness at their upper bounds, in absolute value. */
static void scales(const ant_law *law, const ant_target *t, const ant_box *box, ant_real *T_scale, ant_real *K_scale) {
    const ant_real hi[2] = {box->one.hi, box->two.hi};
    *T_scale = ant_abs(t->T);
    *K_scale = ant_abs(t->K);
    for (int i = 0; i < 2; i++) {
        *T_scale += ant_abs(ant_law_arm(law, i) * ant_law_force(law, i, hi[i]));
        *K_scale += ant_abs(ant_law_stiffness(law, i, hi[i]));
    }
}

/* Where several hold the last in the list of statuses is given. */
static ant_status last_of(ant_status one, ant_status two) { return one > two ? one : two; }

static ant_status verdict(const ant_law *law, const ant_target *t, const ant_box *box, const ant_allocation *a,
                          int outside) {
    ant_real T_scale, K_scale;
    scales(law, t, box, &T_scale, &K_scale);
    const int T_missed = ant_abs(a->T - t->T) > ANT_MET * T_scale, K_missed = ant_abs(a->K - t->K) > ANT_MET * K_scale;
    const int missed = (T_missed ? ANT_TORQUE_LIMITED : 0) | (K_missed ? ANT_STIFFNESS_LIMITED : 0);
    return last_of(outside ? ANT_OUTSIDE_JOINT_RANGE : (ant_status)missed, last_of(box->one.status, box->two.status));
}

/* Where the pressures are now, or the least, as far as there is sense in it: the answer to a question without one. */
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
    const int outside = t->theta < ANT_LEFT ? ANT_LEFT_LIMIT : t->theta > ANT_RIGHT ? ANT_RIGHT_LIMIT : 0;
    const ant_law law = ant_law_at(ant_clip(t->theta, ANT_LEFT, ANT_RIGHT));
    const ant_box box = box_at(&law, t);
    if (!ant_law_holds(&law, &box)) return refusal(t, ANT_BEYOND_MODEL);
    const ant_pair P = t->priority == ANT_TORQUE_FIRST ? ant_law_torque_first(&law, &box, t->T, t->K)
                                                       : ant_law_stiffness_first(&law, &box, t->T, t->K);
    ant_allocation a = {0};
    a.P1 = P.P1;
    a.P2 = P.P2;
    a.T = ant_law_arm(&law, 0) * ant_law_force(&law, 0, P.P1) - ant_law_arm(&law, 1) * ant_law_force(&law, 1, P.P2);
    a.K = ant_law_stiffness(&law, 0, P.P1) + ant_law_stiffness(&law, 1, P.P2);
    a.status = verdict(&law, t, &box, &a, outside);
    a.limits = binding(P.P1, &box.one, ANT_HI1, AGONIST) | binding(P.P2, &box.two, ANT_HI2, ANTAGONIST) | outside;
    return a;
}
