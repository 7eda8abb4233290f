/* Motion of the machine over a sample of constant commands, and its derivatives.
 *
 * y has the integrated states z, ANT_MOVING numbers: all of a joint, or the angles and rates of an arm without gas,
 * whose pressures are known; then, if they are wanted, the entries of S = dz/d(x, u, d) that are not constant,
 * ANT_VARIED numbers in all. */
#ifndef ANT_MOTION_H
#define ANT_MOTION_H

#include "antagonist.h"

enum {
#ifdef ANT_ARM
    ANT_BY_D = ANT_STATES + ANT_MUSCLES, /* columns of S: states, commands, then d */
    ANT_COLUMNS = ANT_BY_D + ANT_JOINTS,
    ANT_VARIED = ANT_MOVING * (1 + ANT_COLUMNS)
#else
    ANT_MOVING = ANT_STATES
#endif
};

/* The first `length` numbers of y, ANT_MOVING or ANT_VARIED, after a sample from the state x; y is at its beginning. */
void ant_advance(ant_real *y, int length, const ant_real *x, const ant_real *u, const ant_real *d);

/* The state after a sample, and with its derivatives by x, u and d. */
void ant_model_stage(const ant_real *x, const ant_real *u, const ant_real *d, ant_real *later);
void ant_model_slopes(const ant_real *x, const ant_real *u, const ant_real *d, ant_real *later, ant_real *A,
                      ant_real *B, ant_real *by_d);

/* The rates of the first `length` numbers of y, at the beginning, middle or end (place 0, 1, 2) of an integration step;
 * for machines of each kind in rate.c, as are the two functions above. */
void ant_rate(const ant_real *y, int length, const ant_real *x, const ant_real *u, const ant_real *d, int step,
              int place, ant_real *rate);

#endif /* ANT_MOTION_H */
