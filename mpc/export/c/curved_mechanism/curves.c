/* What a muscle can do at a posture is a curve (F(P), k(P)); polygons enclose its parts. Along a part whose slope
 * dk/dF keeps between two values the lines of these slopes through both ends enclose it; where the slope only rises, or
 * only falls, one side of the chord is enough. As in Python's relaxation/curves.py, which also finds where the slope
 * turns: here by samples, of which the export has checked that they see every turn. */
#include "curved.h"
#include "mechanism.h"
#include "real.h"

enum { RISING = 33, HALVINGS = 60 };

/* k'' F' - k' F'', which is 0 where the slope turns, and where it is nothing but rounding. */
static ant_real turning(const ant_memory *o, int j, ant_real P) {
    const ant_state s = ant_at(o, j, P);
    const ant_real one = s.k_PP * s.F_P, other = s.k_P * s.F_PP;
    return ant_abs(one - other) > ANT_STRAIGHTNESS * (ant_abs(one) + ant_abs(other)) ? one - other : 0;
}

/* Remember a break of muscle j, in its place. */
static void remember(ant_memory *o, int j, ant_real P) {
    if (o->breaking[j] >= ANT_BREAKS) {
        o->seen = 0; /* more than the law has */
        return;
    }
    int place = o->breaking[j]++;
    for (; place > 0 && o->breaks[j][place - 1] > P; place--) o->breaks[j][place] = o->breaks[j][place - 1];
    o->breaks[j][place] = P;
}

/* Find where the slope turns between two kinks, by signs that change from sample to sample. */
static void turns(ant_memory *o, int j, ant_real a, ant_real b) {
    ant_real last = 0, at = a;
    for (int i = 0; i <= ANT_SAMPLES[j] && ANT_SAMPLES[j] > 0; i++) {
        const ant_real P = a + (b - a) * (ant_real)i / (ant_real)ANT_SAMPLES[j];
        const ant_real value = turning(o, j, P);
        if (value == 0) continue;
        if (last != 0 && (value < 0) != (last < 0)) {
            ant_real low = at, high = P;
            for (int h = 0; h < HALVINGS; h++) {
                const ant_real middle = (low + high) / 2;
                if ((turning(o, j, middle) < 0) == (last < 0)) {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            remember(o, j, (low + high) / 2);
        }
        last = value;
        at = P;
    }
}

void ant_look_at_curves(ant_memory *o) {
    o->rising = o->seen = 1;
    for (int j = 0; j < ANT_MUSCLES; j++) {
        const ant_real lo = o->lo[j], hi = o->hi[j], beside = ANT_BESIDE * (hi - lo);
        o->breaking[j] = 0;
        if (!(lo < hi)) continue;
        for (int i = 0; i < RISING; i++) {
            ant_real F, gain;
            ant_force(o, j, lo + (hi - lo) * (ant_real)i / (ant_real)(RISING - 1), &F, &gain);
            if (!(gain > 0)) o->rising = 0;
        }
        if (ANT_STRAIGHT[j]) continue;
        ant_real begin = lo;
        for (int i = 0; i < ANT_KINKS; i++) {
            const ant_real kink = ANT_KINK[j][i];
            if (!(kink > lo && kink < hi)) continue;
            turns(o, j, begin, kink - beside);
            remember(o, j, kink);
            begin = kink + beside;
        }
        turns(o, j, begin, hi);
    }
}

static void point(const ant_memory *o, int j, ant_real P, ant_real *at) {
    const ant_state s = ant_at(o, j, P);
    at[0] = s.F;
    at[1] = s.k;
}

ant_polygon ant_enclosure(const ant_memory *o, int j, ant_real a, ant_real b) {
    ant_polygon p = {1, {{0, 0}, {0, 0}, {0, 0}, {0, 0}}};
    const ant_real beside = ANT_BESIDE * (o->hi[j] - o->lo[j]);
    point(o, j, a, p.at[0]);
    if (!(b > a)) return p;
    p.corners = 2;
    point(o, j, b, p.at[1]);
    if (ANT_STRAIGHT[j]) return p;
    ant_real least = ANT_INFINITY, greatest = -ANT_INFINITY, size = 0, slope = 0, first = 0;
    int one_way = 1;
    for (int i = -1; i <= o->breaking[j]; i++) { /* both sides of every break, and the ends */
        const ant_real P = i < 0 ? a : i < o->breaking[j] ? o->breaks[j][i] : b;
        if (i >= 0 && i < o->breaking[j] && !(P > a + beside && P < b - beside)) continue;
        if (i >= 0 && i < o->breaking[j]) one_way = 0;
        for (int side = 0; side < 2; side++) {
            if ((i < 0 && side == 0) || (i == o->breaking[j] && side == 1)) continue;
            const ant_state s = ant_at(o, j, side ? P + beside : P - beside);
            slope = s.k_P / s.F_P;
            if (i < 0) first = slope;
            if (slope < least) least = slope;
            if (slope > greatest) greatest = slope;
            if (ant_abs(slope) > size) size = ant_abs(slope);
        }
    }
    const ant_real wider = ANT_WIDER * size, width = p.at[1][0] - p.at[0][0], rise = p.at[1][1] - p.at[0][1];
    least -= wider;
    greatest += wider;
    const ant_real chord = width > 0 ? ant_clip(rise / width, least, greatest) : least;
    if (greatest - least <= 4 * wider) return p;
    const ant_real x = width * (greatest - chord) / (greatest - least);
    const ant_real low[2] = {p.at[0][0] + x, p.at[0][1] + least * x};
    const ant_real high[2] = {p.at[0][0] + (width - x), p.at[0][1] + (width - x) * greatest};
    const int rises = slope > first;
    for (int i = 0; i < 2; i++) {
        p.at[2][i] = one_way && !rises ? high[i] : low[i];
        p.at[3][i] = high[i];
    }
    p.corners = one_way ? 3 : 4;
    return p;
}
