/* What is asked of a target before it is answered, and of a stiffness. */
#ifndef ANT_TARGET_H
#define ANT_TARGET_H

#include "antagonist.h"

/* Whether a stiffness is positive definite, by the pivots of its elimination. */
int ant_positive_definite(const ant_real *K);

/* Whether the numbers of a target are some that there can be. */
int ant_sensible(const ant_target *target);

/* The pressures now, as far as there is sense in them: the answer to a question without one. */
void ant_refuse(const ant_target *target, ant_allocation *allocation);

#endif /* ANT_TARGET_H */
