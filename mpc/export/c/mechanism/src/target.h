/* Checks of a target and of a stiffness. */
#ifndef ANT_TARGET_H
#define ANT_TARGET_H

#include "antagonist.h"

/* Whether a stiffness is positive definite, by the pivots of its elimination. */
int ant_positive_definite(const ant_real *K);

/* Whether the numbers of a target are valid. */
int ant_sensible(const ant_target *target);

/* The present pressures, as far as they are valid: the answer to an invalid target. */
void ant_refuse(const ant_target *target, ant_allocation *allocation);

#endif /* ANT_TARGET_H */
