/* The limit: tondu_exact of allocator/allocation/two_muscles/kernels/source.py (torque first, cables taut) as one loop that gcc can
   vectorise. By hand, because gcc does not vectorise a loop over the C that is printed from that text, which takes five
   times as long; the benchmark insists on equal answers before it counts time. */
#include <math.h>
#include <stdint.h>

typedef struct {
    double S, R, l0, eps0, q, c, d, e, g, lo, hi, left, right, near;
    int32_t hi_limit1, hi_limit2, below, above;
} numbers;

#define CLIP(x, lo, hi) fmin_(fmax_(x, lo), hi)
#define ON(P, limit, flag) (fabs((P) - (limit)) <= p.near ? (flag) : 0)
static inline double fmax_(double a, double b) { return a > b ? a : b; }
static inline double fmin_(double a, double b) { return a < b ? a : b; }

static inline double pressure(double F, double eps, const numbers p) {
    double q1 = p.q * p.d - p.c * eps - F / p.S, q0 = -(p.e * eps + p.d * F / p.S);
    double square = q1 * q1 - 4 * p.q * q0;
    double found = 2 * q0 / (-q1 + sqrt(fmax_(square, 0.0)));
    return square >= 0 ? found : INFINITY;
}

static inline double u_of(double f, double eps, const numbers p) {
    double h = p.q * p.d + p.c * eps + f, square = h * h + 4 * p.q * eps * p.g;
    double found = (h - sqrt(fmax_(square, 0.0))) / (2 * p.q);
    return square >= 0 ? found : INFINITY;
}

static inline double f_of(double P, double r, double eps, const numbers p) {
    return p.q * P - eps * (p.c + p.g * r);
}

void allocate(int64_t n, const double *restrict theta, const double *restrict K, const double *restrict T,
              const numbers *restrict shared, double min_force, double *restrict P1, double *restrict P2,
              double *restrict T_given, double *restrict K_given, int8_t *restrict status, int32_t *restrict limits) {
    const numbers p = *shared;
    const double T_unit = p.S * p.R, K_unit = p.S * p.R * p.R / p.l0, d = p.d;
    for (int64_t i = 0; i < n; i++) {
        int32_t outside = theta[i] < p.left ? p.below : theta[i] > p.right ? p.above : 0;
        double X = p.R * CLIP(theta[i], p.left, p.right) / p.l0, eps1 = p.eps0 + X, eps2 = p.eps0 - X;
        double taut1 = pressure(min_force, eps1, p), taut2 = pressure(min_force, eps2, p);
        int slack = (taut1 > p.hi + p.near) | (taut2 > p.hi + p.near);
        double lo1 = CLIP(taut1, p.lo, p.hi), lo2 = CLIP(taut2, p.lo, p.hi), hi = p.hi;
        double rl1 = 1 / (lo1 + d), rl2 = 1 / (lo2 + d), rh = 1 / (hi + d);
        double fl1 = f_of(lo1, rl1, eps1, p), fl2 = f_of(lo2, rl2, eps2, p);
        double fh1 = f_of(hi, rh, eps1, p), fh2 = f_of(hi, rh, eps2, p);
        double tau = T[i] / T_unit, s = (K[i] / K_unit - 2 * p.c) / p.g;
        int too_low = tau <= fl1 - fh2, too_high = tau >= fh1 - fl2;
        tau = CLIP(tau, fl1 - fh2, fh1 - fl2);
        int at1 = tau <= fl1 - fl2;
        double u = u_of(at1 ? fl1 - tau : fl2 + tau, at1 ? eps2 : eps1, p) - d;
        double a1 = at1 ? lo1 : CLIP(u, lo1, hi), a2 = at1 ? CLIP(u, lo2, hi) : lo2;
        at1 = tau >= fh1 - fh2;
        u = u_of(at1 ? fh1 - tau : fh2 + tau, at1 ? eps2 : eps1, p) - d;
        double b1 = at1 ? hi : CLIP(u, lo1, hi), b2 = at1 ? CLIP(u, lo2, hi) : hi;
        int at_a = s >= 1 / (a1 + d) + 1 / (a2 + d), at_b = s <= 1 / (b1 + d) + 1 / (b2 + d);
        s = CLIP(s, 2 * rh, rl1 + rl2);
        double kappa = -p.g * (eps1 + eps2) * s * s / (8 * p.q);
        double t = -(tau + (p.c + p.g * s / 2) * (eps1 - eps2)) * s / (4 * p.q), rest = 1 - kappa;
        double z = t * rest / (rest * rest + t * t);
        for (int k = 0; k < 4; k++) z -= (((kappa * z + t) * z + rest) * z - t) / ((3 * kappa * z + 2 * t) * z + rest);
        double Q1 = CLIP(2 / (s * (1 + z)) - d, lo1, hi), Q2 = CLIP(2 / (s * (1 - z)) - d, lo2, hi);
        Q1 = at_b ? b1 : Q1, Q2 = at_b ? b2 : Q2;
        Q1 = at_a ? a1 : Q1, Q2 = at_a ? a2 : Q2;
        Q1 = too_low ? lo1 : Q1, Q2 = too_low ? hi : Q2;
        Q1 = too_high ? hi : Q1, Q2 = too_high ? lo2 : Q2;
        double r1 = 1 / (Q1 + d), r2 = 1 / (Q2 + d), f1 = f_of(Q1, r1, eps1, p), f2 = f_of(Q2, r2, eps2, p);
        double T_now = T_unit * (f1 - f2), K_now = K_unit * (2 * p.c + p.g * (r1 + r2));
        double T_scale = T_unit * (fabs(fh1) + fabs(fh2)) + fabs(T[i]);
        double K_scale = K_unit * 2 * fabs(p.c + p.g * rh) + fabs(K[i]);
        int32_t found = (fabs(T_now - T[i]) > 1e-9 * T_scale ? 1 : 0) + (fabs(K_now - K[i]) > 1e-9 * K_scale ? 2 : 0);
        status[i] = (int8_t)(outside ? 8 : slack ? 7 : found); /* of `allocator.Status` */
        limits[i] = ON(Q1, p.lo, 1) | ON(Q1, taut1, 16) | ON(Q1, hi, p.hi_limit1) | ON(Q2, p.lo, 4) |
                    ON(Q2, taut2, 32) | ON(Q2, hi, p.hi_limit2) | outside;
        P1[i] = Q1, P2[i] = Q2, T_given[i] = T_now, K_given[i] = K_now;
    }
}
