/* The pressures that the limits leave at an angle: an interval for each muscle, and where each limit lies. */
#ifndef ANT_BOX_H
#define ANT_BOX_H

#include "antagonist.h"

typedef struct {
    ant_real lo, hi;            /* [Pa]; equal where no pressure keeps all limits */
    ant_real taut, ceiling;     /* pressures of the least and the greatest force [Pa] */
    ant_real nearest, farthest; /* what the slew limit leaves [Pa] */
    ant_status status;          /* ANT_EXACT, or why not all limits are kept */
} ant_interval;

typedef struct {
    ant_interval one, two; /* agonist, antagonist */
} ant_box;

typedef struct {
    ant_real P1, P2; /* [Pa] */
} ant_pair;

#endif /* ANT_BOX_H */
