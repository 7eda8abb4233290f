/* Branch and bound closes the gap between the best pressures that are known and what is proved to be impossible. A node is
 * an interval of pressure for each muscle; it is split across the muscle whose relaxed (F, k) is farthest from its curve.
 * As in Python's relaxation/tree.py, but depth first, which takes a stack in the place of a heap. */
#include "curved.h"
#include "mechanism.h"
#include "real.h"

enum { STEPS = 15, PATIENCE = 8 }; /* of a descent from a node; descents that find nothing better */

#define INSIDE ANT_R(0.1)  /* of an interval: it is not split nearer to its ends */
#define NEARLY ANT_R(1e-2) /* weighted [N*m] or [N*m/rad] */

/* Fill in the pressures of a node that give the relaxed forces. */
static void pressures(const ant_memory *o, const ant_node *node, ant_real *P) {
    for (int j = 0; j < ANT_MUSCLES; j++) {
        const ant_real wanted = o->v[2 * j];
        ant_real lo = node->lo[j], hi = node->hi[j], F, gain;
        P[j] = (lo + hi) / 2;
        for (int step = 0; step < 12 && lo < hi; step++) {
            ant_force(o, j, P[j], &F, &gain);
            if (F < wanted) {
                lo = P[j];
            } else {
                hi = P[j];
            }
            const ant_real next = P[j] + (wanted - F) / gain;
            P[j] = next > lo && next < hi ? next : (lo + hi) / 2;
        }
    }
}

/* Whether pressures of this worth cost less than `enough` at level k, and nearly have what the earlier ones achieve. */
static int promises(const ant_memory *o, int k, const ant_found *found, const ant_real *achieved, ant_real enough) {
    for (int i = 0; i < o->ends[k]; i++) {
        if (!(ant_abs(found->left[i] + o->asked[i] - achieved[i]) < NEARLY)) return 0;
    }
    return found->costs[k] < enough;
}

/* Take o->tried for o->best where it is better at level k, and as good before. */
static int better(ant_memory *o, int k) {
    for (int i = 0; i < o->ends[k]; i++) {
        const ant_real off = ant_abs(o->tried.left[i] - o->best.left[i]);
        if (!(off <= ANT_AS_GOOD * (1 + ant_abs(o->asked[i])))) return 0;
    }
    if (!(o->tried.costs[k] < o->best.costs[k])) return 0;
    o->best = o->tried;
    return 1;
}

/* The muscle to split, and the pressure where; -1 where none can be. */
static int split(const ant_memory *o, int k, const ant_node *node, const ant_real *P, ant_real *where) {
    int chosen = -1;
    ant_real farthest = -1;
    for (int j = 0; j < ANT_MUSCLES; j++) {
        if (ANT_STRAIGHT[j] || !(node->hi[j] > node->lo[j])) continue;
        const ant_state s = ant_at(o, j, P[j]);
        const ant_real off[2] = {o->v[2 * j] - s.F, o->v[2 * j + 1] - s.k};
        for (int c = 0; c < 2; c++) {
            ant_real own = 0, before = 0;
            for (int i = 0; i < o->ends[k + 1]; i++) {
                const ant_real square = o->rows[i][2 * j + c] * o->rows[i][2 * j + c];
                if (i < o->ends[k]) {
                    before += square;
                } else {
                    own += square;
                }
            }
            const ant_polygon *p = &o->polygons[j];
            ant_real extent = 0;
            for (int a = 1; a < p->corners; a++) {
                const ant_real wide = ant_abs(p->at[a][c] - p->at[0][c]);
                if (wide > extent) extent = wide;
            }
            const ant_real far = ant_abs(off[c]) * (ANT_F(sqrt)(own) + ANT_F(sqrt)(before)) + ANT_R(1e-9) * extent;
            if (far > farthest) {
                farthest = far;
                chosen = j;
            }
        }
    }
    if (chosen < 0) return chosen;
    const ant_real a = node->lo[chosen], b = node->hi[chosen], margin = ANT_R(1e-6) * (b - a);
    ant_real nearest = ANT_INFINITY;
    *where = ant_clip(P[chosen], a + INSIDE * (b - a), b - INSIDE * (b - a));
    for (int i = 0; i < o->breaking[chosen]; i++) {
        const ant_real at = o->breaks[chosen][i];
        if (at > a + margin && at < b - margin && ant_abs(at - P[chosen]) < nearest) {
            nearest = ant_abs(at - P[chosen]);
            *where = at;
        }
    }
    return chosen;
}

/* Hold in the root the muscles that have to be where they are, since what the earlier level achieves can be had in no
 * other way: with g the gradient of its cost every v with E v = e has g v = g x. Where no corner of any polygon has less
 * than x, muscles at a vertex whose other corners have more stay there. */
static void hold(const ant_memory *o, ant_node *root) {
    ant_real low[ANT_MUSCLES], other[ANT_MUSCLES], size = 0, loose = 0;
    for (int j = 0; j < ANT_MUSCLES; j++) {
        const ant_state s = ant_at(o, j, o->best.P[j]);
        const ant_polygon p = ant_enclosure(o, j, o->lo[j], o->hi[j]);
        const int own = o->best.P[j] <= o->lo[j] ? 0 : o->best.P[j] >= o->hi[j] ? 1 : -1;
        ant_real g[2] = {0, 0}, most = 0;
        for (int i = 0; i < o->ends[1]; i++) {
            for (int c = 0; c < 2; c++) g[c] += o->rows[i][2 * j + c] * o->best.left[i];
        }
        low[j] = 0;
        other[j] = own < 0 ? 0 : ANT_INFINITY;
        for (int c = 0; c < p.corners; c++) {
            const ant_real by = g[0] * (p.at[c][0] - s.F) + g[1] * (p.at[c][1] - s.k);
            if (c != own && by < other[j]) other[j] = by;
            if (c != own && by < low[j]) low[j] = by;
            if (ant_abs(by) > most) most = ant_abs(by);
        }
        size += most;
        loose -= low[j];
    }
    if (!(loose <= ANT_TIGHT * size)) return;
    for (int j = 0; j < ANT_MUSCLES; j++) {
        if (other[j] > ANT_HOLDS * size) root->lo[j] = root->hi[j] = o->best.P[j];
    }
}

/* The least bound of the nodes on the stack, and of what is done. */
static ant_real least_bound(const ant_memory *o, int count, ant_real done) {
    for (int i = 0; i < count; i++) {
        if (o->stack[i].bound < done) done = o->stack[i].bound;
    }
    return done;
}

ant_real ant_close(ant_memory *o, int k, ant_real gap, int most_nodes, int *nodes) {
    ant_real achieved[ANT_ROWS], done = ANT_INFINITY;
    int count = 1, failed = 0, taken = 0;
    for (int i = 0; i < ANT_ROWS; i++) achieved[i] = o->best.left[i] + o->asked[i];
    for (int j = 0; j < ANT_MUSCLES; j++) {
        o->stack[0].lo[j] = o->lo[j];
        o->stack[0].hi[j] = o->hi[j];
    }
    for (int i = 0; i < ANT_ROWS; i++) o->stack[0].dual[i] = 0;
    o->stack[0].bound = 0;
    o->stack[0].solved = 0;
    if (k > 0) hold(o, &o->stack[0]);
    while (count > 0 && taken < most_nodes) {
        ant_node node = o->stack[--count];
        const ant_real cost = o->best.costs[k], enough = cost - gap * (1 + cost);
        if (node.bound < enough) {
            for (int j = 0; j < ANT_MUSCLES; j++) o->polygons[j] = ant_enclosure(o, j, node.lo[j], node.hi[j]);
            ant_bound(o, k, achieved, &node);
            taken++;
        }
        if (!(node.bound < enough)) {
            if (node.bound < done) done = node.bound;
            continue;
        }
        ant_real where = 0;
        pressures(o, &node, o->tried.P);
        const int muscle = count + 2 > ANT_DEPTH ? -1 : split(o, k, &node, o->tried.P, &where);
        ant_worth(o, &o->tried);
        if ((taken & (taken + 1)) == 0 || (failed < PATIENCE && promises(o, k, &o->tried, achieved, enough))) {
            ant_descend(o, &o->tried, STEPS);
            failed += !better(o, k);
        }
        if (muscle < 0) { /* it cannot be split any more */
            if (node.bound < done) done = node.bound;
            continue;
        }
        o->stack[count] = o->stack[count + 1] = node;
        o->stack[count++].lo[muscle] = where;
        o->stack[count++].hi[muscle] = where;
    }
    *nodes += taken;
    const ant_real bound = least_bound(o, count, done);
    return bound < o->best.costs[k] ? bound : o->best.costs[k];
}
