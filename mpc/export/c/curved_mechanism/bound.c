/* The curves are relaxed to polygons around them: a convex QP, which the kernel solves, and a lower bound that is safe
 * whatever came out of that. With g = G'(G x - b) + E' lambda every v in the polygons with E v = e has
 *     |G v - b|^2 / 2 >= |G x - b|^2 / 2 + lambda (E x - e) + the sum over the muscles of min g_j (corner - x_j)   (B)
 * As in Python's relaxation/bound.py. */
#include "curved.h"
#include "mechanism.h"
#include "real.h"

/* Fill in x -> v = corner + edges x of each polygon: where its two edges begin, and the edges. */
static void coordinates(const ant_polygon *p, ant_real *corner, ant_real edges[2][2]) {
    const int begin = p->corners == 3 ? 2 : 0;
    const int ends[2] = {p->corners == 3 ? 0 : p->corners == 4 ? 2 : 1, p->corners == 4 ? 3 : 1};
    for (int i = 0; i < 2; i++) {
        corner[i] = p->at[begin][i];
        edges[0][i] = p->corners > 1 ? p->at[ends[0]][i] - corner[i] : 0;
        edges[1][i] = p->corners > 2 ? p->at[ends[1]][i] - corner[i] : 0;
    }
}

/* The bound that `dual` proves for the rows from `begin` to `end`, those before them being equalities: twice the
 * right-hand side of (B), where dual is G x - b, and then lambda; a bound whatever it is, and at any v. */
static ant_real safe(const ant_memory *o, int begin, int end, const ant_real *right, const ant_real *dual) {
    ant_real g[ANT_VARIABLES], value = 0;
    for (int j = 0; j < ANT_VARIABLES; j++) g[j] = 0;
    for (int i = 0; i < end; i++) {
        ant_real off = -right[i];
        for (int j = 0; j < ANT_VARIABLES; j++) off += o->rows[i][j] * o->v[j];
        for (int j = 0; j < ANT_VARIABLES; j++) g[j] += dual[i] * o->rows[i][j];
        value += dual[i] * off - (i >= begin ? dual[i] * dual[i] / 2 : 0);
    }
    for (int j = 0; j < ANT_MUSCLES; j++) {
        const ant_polygon *p = &o->polygons[j];
        ant_real least = ANT_INFINITY;
        for (int c = 0; c < p->corners; c++) {
            const ant_real by = g[2 * j] * (p->at[c][0] - o->v[2 * j]) + g[2 * j + 1] * (p->at[c][1] - o->v[2 * j + 1]);
            if (by < least) least = by;
        }
        value += least;
    }
    return 2 * value;
}

/* Fill in G v - right, for the rows up to `end`. */
static void errors(const ant_memory *o, int end, const ant_real *right, ant_real *off) {
    for (int i = 0; i < end; i++) {
        off[i] = -right[i];
        for (int j = 0; j < ANT_VARIABLES; j++) off[i] += o->rows[i][j] * o->v[j];
    }
}

/* Fill in the rows of level k and of the one before it, in the coordinates of the polygons. */
static void in_coordinates(ant_memory *o, int k, const ant_real *right) {
    for (int i = 0; i < ANT_LINES; i++) {
        for (int j = 0; j < ANT_VARIABLES; j++) o->A[i][j] = 0;
        o->b[i] = i < ANT_MUSCLES ? 1 : i - ANT_MUSCLES < o->ends[k + 1] ? right[i - ANT_MUSCLES] : 0;
        o->onesided[i] = i < ANT_MUSCLES;
    }
    for (int j = 0; j < ANT_MUSCLES; j++) {
        ant_real corner[2], edges[2][2];
        coordinates(&o->polygons[j], corner, edges);
        const int corners = o->polygons[j].corners;
        for (int e = 0; e < 2; e++) {
            const int x = 2 * j + e;
            o->lo_x[x] = o->centre[x] = 0;
            o->hi_x[x] = corners == 3 ? 2 : corners > e + 1 ? 1 : 0; /* of a triangle the row is the bound */
            o->A[j][x] = corners == 3;
            for (int i = 0; i < o->ends[k + 1]; i++) {
                const ant_real *row = &o->rows[i][2 * j];
                o->A[ANT_MUSCLES + i][x] = row[0] * edges[e][0] + row[1] * edges[e][1];
                o->b[ANT_MUSCLES + i] -= e == 0 ? row[0] * corner[0] + row[1] * corner[1] : 0;
            }
        }
    }
    o->kernel_ends[0] = ANT_MUSCLES;
    o->kernel_ends[1] = ANT_MUSCLES + o->ends[k];
    o->kernel_ends[2] = ANT_LINES;
}

/* Solve the QP, from the sides of the node's parent and, where that does not end, anew. */
static void solve(ant_memory *o, ant_node *node) {
    const ant_levels levels = {(const ant_real(*)[ANT_VARIABLES])o->A, o->b, o->onesided, o->kernel_ends};
    const ant_box box = {o->lo_x, o->hi_x, o->centre};
    ant_kernel_prepare(&levels, &o->work);
    if (!node->solved || !ant_kernel_solve(&levels, &box, o->x, node->side, o->mu, 1, &o->work)) {
        node->solved = ant_kernel_solve(&levels, &box, o->x, node->side, o->mu, 0, &o->work) > 0;
    }
    for (int j = 0; j < ANT_MUSCLES; j++) {
        ant_real corner[2], edges[2][2];
        coordinates(&o->polygons[j], corner, edges);
        for (int i = 0; i < 2; i++) {
            o->v[2 * j + i] = corner[i] + edges[0][i] * o->x[2 * j] + edges[1][i] * o->x[2 * j + 1];
        }
    }
}

void ant_bound(ant_memory *o, int k, const ant_real *achieved, ant_node *node) {
    const int begin = o->ends[k], end = o->ends[k + 1];
    ant_real right[ANT_ROWS], dual[ANT_ROWS];
    for (int i = 0; i < end; i++) right[i] = i < begin ? achieved[i] : o->asked[i];
    in_coordinates(o, k, right);
    solve(o, node);
    errors(o, end, right, dual);
    if (begin > 0) {
        ant_real size = 1;
        for (int i = 0; i < begin; i++) size += right[i] * right[i];
        if (safe(o, 0, begin, right, dual) > ANT_APART * ANT_APART * size) {
            node->bound = ANT_INFINITY;
            return;
        }
    }
    for (int i = 0; i < begin; i++) dual[i] = o->mu[2][ANT_MUSCLES + i];
    const ant_real own = safe(o, begin, end, right, dual), other = safe(o, begin, end, right, node->dual);
    if (own > other) {
        for (int i = 0; i < end; i++) node->dual[i] = dual[i];
    }
    if (own > node->bound) node->bound = own; /* NaN is not */
    if (other > node->bound) node->bound = other;
}
