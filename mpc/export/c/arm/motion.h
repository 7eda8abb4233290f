/* Motion of an arm over a sample, and its derivatives. */
#ifndef ANT_MOTION_H
#define ANT_MOTION_H

#include "antagonist.h"

enum {
    ANT_MOVING = 2 * ANT_JOINTS,               /* angles and rates */
    ANT_BY_D = ANT_STATES + ANT_MUSCLES,       /* columns of ant_slopes: q, rates, P, u, then d */
    ANT_COLUMNS = ANT_BY_D + ANT_JOINTS
};

/* Derivatives of the next angles and rates. */
typedef ant_real ant_slopes[ANT_MOVING][ANT_COLUMNS];

/* The next state; slopes may be NULL. */
void ant_advance(const ant_real x[ANT_STATES], const ant_real u[ANT_MUSCLES], const ant_real d[ANT_JOINTS],
                 ant_real later[ANT_STATES], ant_slopes *slopes);

/* As the printed formulas of a joint: the next state, and with its derivatives by x, u and d. */
void ant_model_stage(const ant_real *x, const ant_real *u, const ant_real *d, ant_real *later);
void ant_model_slopes(const ant_real *x, const ant_real *u, const ant_real *d, ant_real *later, ant_real *A,
                      ant_real *B, ant_real *by_d);

#endif /* ANT_MOTION_H */
