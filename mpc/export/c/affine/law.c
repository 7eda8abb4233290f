/* Muscles affine in the pressure leave torque and stiffness affine in (P1, P2), in any geometry: straight lines. */
#include "law.h"
#include "model.h"
#include "real.h"

/* An affine function of the pressures, less its value at zero. */
typedef struct {
    ant_real by1, by2; /* per Pa */
} line;

ant_law ant_law_at(ant_real theta) {
    ant_real one[5], two[5];
    ant_model_sides(&theta, one, two);
    const ant_law law = {{{one[0], one[1], one[2], one[3], one[4]}, {two[0], two[1], two[2], two[3], two[4]}}};
    return law;
}

ant_real ant_law_arm(const ant_law *law, int muscle) { return law->side[muscle].arm; }

ant_real ant_law_force(const ant_law *law, int muscle, ant_real P) {
    return law->side[muscle].A * P + law->side[muscle].B;
}

ant_real ant_law_stiffness(const ant_law *law, int muscle, ant_real P) {
    return law->side[muscle].k * P + law->side[muscle].k0;
}

ant_real ant_law_pressure(const ant_law *law, int muscle, ant_real force) {
    return (force - law->side[muscle].B) / law->side[muscle].A;
}

static line torque(const ant_law *law) {
    const line T = {law->side[0].arm * law->side[0].A, -law->side[1].arm * law->side[1].A};
    return T;
}

static line stiffness(const ant_law *law) {
    const line K = {law->side[0].k, law->side[1].k};
    return K;
}

/* More pressure pulls more, and torque and stiffness are two different functions of the pressures. */
int ant_law_holds(const ant_law *law, const ant_box *box) {
    const line T = torque(law), K = stiffness(law);
    (void)box;
    return law->side[0].A > 0 && law->side[1].A > 0 && T.by1 * K.by2 - T.by2 * K.by1 > 0 && K.by1 != 0 && K.by2 != 0;
}

/* The pressures with x nearest to X, and of them those with y nearest to Y. A level of x is a straight line, on which y
 * is affine; from m to M is the way in which x grows. */
static ant_pair lexicographic(line x, ant_real X, line y, ant_real Y, const ant_box *box) {
    const ant_real lo1 = box->one.lo, hi1 = box->one.hi, lo2 = box->two.lo, hi2 = box->two.hi;
    const ant_real m1 = x.by1 > 0 ? lo1 : hi1, M1 = x.by1 > 0 ? hi1 : lo1;
    const ant_real m2 = x.by2 > 0 ? lo2 : hi2, M2 = x.by2 > 0 ? hi2 : lo2;
    X = ant_clip(X, x.by1 * m1 + x.by2 * m2, x.by1 * M1 + x.by2 * M2);
    ant_pair a = {m1, M2}, b = {M1, m2}; /* the ends of the line: one pressure is at its bound */
    if (x.by1 * m1 + x.by2 * M2 <= X)
        a.P1 = ant_clip((X - x.by2 * M2) / x.by1, lo1, hi1);
    else
        a.P2 = ant_clip((X - x.by1 * m1) / x.by2, lo2, hi2);
    if (x.by1 * M1 + x.by2 * m2 <= X)
        b.P2 = ant_clip((X - x.by1 * M1) / x.by2, lo2, hi2);
    else
        b.P1 = ant_clip((X - x.by2 * m2) / x.by1, lo1, hi1);
    const ant_real Ya = y.by1 * a.P1 + y.by2 * a.P2, Yb = y.by1 * b.P1 + y.by2 * b.P2;
    const ant_real share = Yb != Ya ? (Y - Ya) / (Yb - Ya) : 0;
    if (share <= 0) return a;
    if (share >= 1) return b;
    const ant_pair P = {a.P1 + share * (b.P1 - a.P1), a.P2 + share * (b.P2 - a.P2)};
    return P;
}

ant_pair ant_law_torque_first(const ant_law *law, const ant_box *box, ant_real T, ant_real K) {
    const ant_side *one = &law->side[0], *two = &law->side[1];
    T -= one->arm * one->B - two->arm * two->B;
    return lexicographic(torque(law), T, stiffness(law), K - one->k0 - two->k0, box);
}

ant_pair ant_law_stiffness_first(const ant_law *law, const ant_box *box, ant_real T, ant_real K) {
    const ant_side *one = &law->side[0], *two = &law->side[1];
    T -= one->arm * one->B - two->arm * two->B;
    return lexicographic(stiffness(law), K - one->k0 - two->k0, torque(law), T, box);
}
