/* Work space of ant_allocate. */
#ifndef ANTAGONIST_MEMORY_H
#define ANTAGONIST_MEMORY_H

#include "src/kernel.h"

typedef struct {
    ant_work work;
    ant_real lo[ANT_MUSCLES], hi[ANT_MUSCLES], centre[ANT_MUSCLES]; /* of pressures in units of ANT_UNIT */
    ant_real x[ANT_MUSCLES];
    ant_real A[ANT_ROWS][ANT_MUSCLES], b[ANT_ROWS];
    ant_real mu[ANT_LEVELS + 1][ANT_ROWS];
    ant_real y[ANT_ROWS], given[ANT_ROWS], y0[ANT_ROWS], M[ANT_ROWS][ANT_MUSCLES];
    signed char onesided[ANT_ROWS], side[ANT_MUSCLES + ANT_ROWS], held[ANT_MUSCLES + ANT_ROWS];
    int ends[ANT_LEVELS];
    int solved; /* whether `side` is the answer of the last call */
} ant_memory;

#endif /* ANTAGONIST_MEMORY_H */
