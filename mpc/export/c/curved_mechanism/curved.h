/* The parts of the allocation of muscles that are not affine in the pressure; the names are those of Python's
 * allocator/mechanism/relaxation. */
#ifndef ANT_CURVED_H
#define ANT_CURVED_H

#include "antagonist.h"

/* What a muscle's law gives at a pressure: force, own stiffness, and their derivatives. */
typedef struct {
    ant_real F, k, F_P, k_P, F_PP, k_PP;
} ant_state;

/* model.c: muscle j at pressure P. */
ant_state ant_at(const ant_memory *o, int j, ant_real P);
void ant_force(const ant_memory *o, int j, ant_real P, ant_real *F, ant_real *F_P);
/* The pressure that gives a force; infinite where there is none. */
ant_real ant_pressure(const ant_memory *o, int j, ant_real F);
/* Fill in the rows, what is asked, the forces at the bounds and the scales; `worth` is of the pressures in it. */
void ant_pose(const ant_target *target, ant_memory *o);
void ant_worth(const ant_memory *o, ant_found *worth);

/* descent.c: the pressures in `now` go down to a local optimum of all levels. */
void ant_descend(ant_memory *o, ant_found *now, int steps);
/* Whether of the first level that changes, by more than `alike` of it, `new` has the lower cost, or none changes. */
int ant_lower(const ant_memory *o, const ant_found *new, const ant_found *old, ant_real alike);
/* How far pressures are from a local optimum, in fractions of its scale. */
ant_real ant_certified(ant_memory *o, const ant_found *found);

/* curves.c: find where the curves turn; enclose a part of one. */
void ant_look_at_curves(ant_memory *o);
ant_polygon ant_enclosure(const ant_memory *o, int j, ant_real a, ant_real b);

/* bound.c: raise node->bound to a cost that no (F, k) in o->polygons are below at level k, with what `achieved` has at
 * the earlier one; infinite where they cannot have that. The node has its parent's sides and dual, and gets its own. Fills
 * in o->v. */
void ant_bound(ant_memory *o, int k, const ant_real *achieved, ant_node *node);

/* tree.c: branch until the cost of o->best at level k and its bound are within `gap`; return the bound. */
ant_real ant_close(ant_memory *o, int k, ant_real gap, int most_nodes, int *nodes);

#endif /* ANT_CURVED_H */
