/* The pressures that the limits leave at an angle: an interval for each muscle, and which limit sets each end. */
#ifndef ANT_BOX_H
#define ANT_BOX_H

#include "antagonist.h"

typedef struct {
    ant_real lo, hi;        /* [Pa] */
    int lo_limit, hi_limit; /* which limit each is */
    int empty;              /* the limits contradict each other: lo = hi = the upper one */
} ant_interval;

typedef struct {
    ant_interval one, two; /* agonist, antagonist */
} ant_box;

typedef struct {
    ant_real P1, P2; /* [Pa] */
} ant_pair;

#endif /* ANT_BOX_H */
