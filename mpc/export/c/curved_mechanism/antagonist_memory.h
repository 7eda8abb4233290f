/* What ant_allocate works in. */
#ifndef ANTAGONIST_MEMORY_H
#define ANTAGONIST_MEMORY_H

#include "src/kernel.h"

/* Pressures, and what they are worth. */
typedef struct {
    ant_real P[ANT_MUSCLES];
    ant_real costs[3];        /* squared errors of both levels, and of the distance from the reference, of the supply */
    ant_real left[ANT_ROWS];  /* weighted errors, level after level */
} ant_found;

/* An interval of pressure for each muscle, and a bound below which no pressures there can have the level's cost. */
typedef struct {
    ant_real lo[ANT_MUSCLES], hi[ANT_MUSCLES], bound, dual[ANT_ROWS]; /* the best multipliers so far */
    signed char side[ANT_VARIABLES + ANT_LINES];                      /* which limits of the polygons bind */
    int solved;                                                       /* whether `side` is an answer */
} ant_node;

/* A polygon around a part of a muscle's curve (F, k): both ends, and the corner or the two on its sides. */
typedef struct {
    int corners;
    ant_real at[4][2];
} ant_polygon;

typedef struct {
    ant_work work;
    ant_real x[ANT_VARIABLES], lo_x[ANT_VARIABLES], hi_x[ANT_VARIABLES], centre[ANT_VARIABLES];
    ant_real A[ANT_LINES][ANT_VARIABLES], b[ANT_LINES];
    ant_real mu[ANT_LEVELS + 1][ANT_LINES];
    signed char onesided[ANT_LINES], side[ANT_VARIABLES + ANT_LINES], held[ANT_VARIABLES + ANT_LINES];
    int kernel_ends[ANT_LEVELS];

    ant_real eps[ANT_MUSCLES], arm[ANT_MUSCLES][ANT_JOINTS], bend[ANT_MUSCLES][ANT_STIFFNESSES];
    ant_real rows[ANT_ROWS][ANT_VARIABLES], asked[ANT_ROWS], scale[2]; /* weighted, level after level */
    int ends[3];                                                    /* where the levels begin and end */
    ant_real lo[ANT_MUSCLES], hi[ANT_MUSCLES], least[ANT_MUSCLES], most[ANT_MUSCLES]; /* pressures, forces there */
    ant_real reference[ANT_MUSCLES];

    ant_real breaks[ANT_MUSCLES][ANT_BREAKS]; /* where a curve turns or has a kink */
    int breaking[ANT_MUSCLES], rising, seen;  /* how many; whether all forces rise, and all turns are found */
    ant_polygon polygons[ANT_MUSCLES];
    ant_real v[ANT_VARIABLES];
    ant_node stack[ANT_DEPTH];

    ant_found best, tried;
    int solved; /* whether `best` is the answer of the last call */
} ant_memory;

#endif /* ANTAGONIST_MEMORY_H */
