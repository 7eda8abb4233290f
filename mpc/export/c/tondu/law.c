/* With the reciprocals r_i = 1/(P_i + d), q = a - b and g = e - cd, two Tondu2021 (arXiv 2104.13167) on a pulley give
 *
 *     T/(S R) = q (P1 - P2) - 2 c X - g (eps1 r1 - eps2 r2),   K l0/(S R^2) = 2 c + g (r1 + r2),   X = R theta/l0
 *
 * so that K fixes s = r1 + r2, and T leaves a cubic in z = (r1 - r2)/s:
 *
 *     kappa z^3 + t z^2 + (1 - kappa) z - t = 0,   kappa = -g eps0 s^2/4q,   t = -(T/(S R) + 2 c X + g X s) s/4q
 */
#include "law.h"
#include "real.h"

static const ant_real S = ANT_AREA, R = ANT_RADIUS, W = ANT_RADIUS / ANT_REST_LENGTH;
static const ant_real q = ANT_Q, c = ANT_C, d = ANT_D, g = ANT_G;
static const ant_real RISES = ANT_R(1e-6); /* of q: the force has to gain so much from pressure */
enum { NEWTON_STEPS = 4 };                 /* after Halley's; proved at export for the whole supply range */

/* A corner of the box, and the forces per area there. */
typedef struct {
    ant_real P1, P2, r1, r2, f1, f2;
} corner;

ant_law ant_law_at(ant_real theta) {
    const ant_real X = W * theta;
    const ant_law law = {{ANT_EPS0 + X, ANT_EPS0 - X}};
    return law;
}

/* Force per area f = q P - eps (c + g r) [Pa]. */
static ant_real area_force(ant_real P, ant_real r, ant_real eps) { return q * P - eps * (c + g * r); }

/* The pressure with the force f per area: P + d is the smaller root u of q u^2 - h u - eps g = 0. */
static ant_real pressure(ant_real f, ant_real eps) {
    const ant_real h = q * d + c * eps + f, square = h * h + 4 * q * eps * g;
    return square >= 0 ? (h - ANT_F(sqrt)(square)) / (2 * q) - d : ANT_INFINITY;
}

ant_real ant_law_arm(const ant_law *law, int muscle) {
    (void)law, (void)muscle;
    return R;
}

ant_real ant_law_force(const ant_law *law, int muscle, ant_real P) {
    return S * area_force(P, 1 / (P + d), law->eps[muscle]);
}

ant_real ant_law_stiffness(const ant_law *law, int muscle, ant_real P) {
    (void)law, (void)muscle;
    return S * R * W * (c + g / (P + d));
}

ant_real ant_law_pressure(const ant_law *law, int muscle, ant_real force) {
    return pressure(force / S, law->eps[muscle]);
}

/* Below the pole, and more pressure pulls more. */
int ant_law_holds(const ant_law *law, const ant_box *box) {
    const ant_real u1 = box->one.hi + d, u2 = box->two.hi + d;
    return u1 < 0 && u2 < 0 && (q * (1 - RISES)) * u1 * u1 + g * law->eps[0] > 0 &&
           (q * (1 - RISES)) * u2 * u2 + g * law->eps[1] > 0;
}

static corner corner_of(const ant_law *law, ant_real P1, ant_real P2) {
    const ant_real r1 = 1 / (P1 + d), r2 = 1 / (P2 + d);
    const corner at = {P1, P2, r1, r2, area_force(P1, r1, law->eps[0]), area_force(P2, r2, law->eps[1])};
    return at;
}

/* The pressures in the box that give tau = T/(S R) and s. */
static ant_pair inverse(const ant_law *law, const ant_box *box, ant_real tau, ant_real s) {
    const ant_real eps1 = law->eps[0], eps2 = law->eps[1];
    const ant_real kappa = -g * (eps1 + eps2) * s * s / (8 * q), rest = 1 - kappa;
    const ant_real t = -(tau + (c + g * s / 2) * (eps1 - eps2)) * s / (4 * q);
    ant_real z = t * rest / (rest * rest + t * t);
    for (int i = 0; i < NEWTON_STEPS; i++)
        z -= (((kappa * z + t) * z + rest) * z - t) / ((3 * kappa * z + 2 * t) * z + rest);
    const ant_pair P = {ant_clip(2 / (s * (1 + z)) - d, box->one.lo, box->one.hi),
                        ant_clip(2 / (s * (1 - z)) - d, box->two.lo, box->two.hi)};
    return P;
}

/* tau brought within reach, and then s within the torque level; K grows as s falls. */
ant_pair ant_law_torque_first(const ant_law *law, const ant_box *box, ant_real T, ant_real K) {
    const corner lo = corner_of(law, box->one.lo, box->two.lo), hi = corner_of(law, box->one.hi, box->two.hi);
    const ant_real tau = ant_clip(T / (S * R), lo.f1 - hi.f2, hi.f1 - lo.f2), s = (K / (S * R * W) - 2 * c) / g;
    ant_pair a = {lo.P1, lo.P2}, b = {hi.P1, hi.P2}; /* the level's ends: one pressure is at its bound */
    if (tau <= lo.f1 - lo.f2)
        a.P2 = ant_clip(pressure(lo.f1 - tau, law->eps[1]), lo.P2, hi.P2);
    else
        a.P1 = ant_clip(pressure(lo.f2 + tau, law->eps[0]), lo.P1, hi.P1);
    if (tau >= hi.f1 - hi.f2)
        b.P2 = ant_clip(pressure(hi.f1 - tau, law->eps[1]), lo.P2, hi.P2);
    else
        b.P1 = ant_clip(pressure(hi.f2 + tau, law->eps[0]), lo.P1, hi.P1);
    if (s >= 1 / (a.P1 + d) + 1 / (a.P2 + d)) return a;
    if (s <= 1 / (b.P1 + d) + 1 / (b.P2 + d)) return b;
    return inverse(law, box, tau, s);
}

/* The same with the goals exchanged: s within [K(lo, lo), K(hi, hi)], then tau within the stiffness level. */
ant_pair ant_law_stiffness_first(const ant_law *law, const ant_box *box, ant_real T, ant_real K) {
    const corner lo = corner_of(law, box->one.lo, box->two.lo), hi = corner_of(law, box->one.hi, box->two.hi);
    const ant_real tau = T / (S * R), s = ant_clip((K / (S * R * W) - 2 * c) / g, hi.r1 + hi.r2, lo.r1 + lo.r2);
    ant_pair a = {lo.P1, hi.P2}, b = {hi.P1, lo.P2}; /* least and greatest torque */
    if (s - lo.r1 >= hi.r2)
        a.P2 = ant_clip(1 / (s - lo.r1) - d, lo.P2, hi.P2);
    else
        a.P1 = ant_clip(1 / (s - hi.r2) - d, lo.P1, hi.P1);
    if (s - hi.r1 <= lo.r2)
        b.P2 = ant_clip(1 / (s - hi.r1) - d, lo.P2, hi.P2);
    else
        b.P1 = ant_clip(1 / (s - lo.r2) - d, lo.P1, hi.P1);
    const corner least = corner_of(law, a.P1, a.P2), most = corner_of(law, b.P1, b.P2);
    if (tau <= least.f1 - least.f2) return a;
    if (tau >= most.f1 - most.f2) return b;
    return inverse(law, box, tau, s);
}
