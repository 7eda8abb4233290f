/* A governor of the pressures of pneumatic muscles, exported from the Python package `antagonist`.
 *
 * Plain C99 without a heap or global state; it needs only math.h. Everything is in SI units: Pa (gauge), rad, N*m, N.
 * The mechanism has ANT_JOINTS joints and ANT_MUSCLES muscles. Also include antagonist_memory.h, for the memory.
 *
 * No input leads to undefined behaviour: invalid input, NaN included, is answered by a status.
 */
#ifndef ANTAGONIST_H
#define ANTAGONIST_H

#include "antagonist_config.h" /* precision and sizes, chosen at export */

#ifdef ANT_SINGLE
typedef float ant_real;
#else
typedef double ant_real;
#endif

/* Result for a command; if several apply, the last one in the list except ANT_GOVERNED_BAD_INPUT. */
enum {
    ANT_GOVERNED_SAFE = 0,           /* unchanged */
    ANT_GOVERNED_MOVED = 1,          /* moved to pressures that keep all limits */
    ANT_GOVERNED_NOT_KEPT = 2,       /* no command is sure to keep the joint range or the energy */
    ANT_GOVERNED_CONFLICT = 5,       /* the limits of a muscle contradict each other: the supply was kept first */
    ANT_GOVERNED_SLACK = 6,          /* a muscle can have no pressure that keeps it taut */
    ANT_GOVERNED_OUTSIDE_LIMITS = 9, /* the slew leaves a muscle no pressure in its supply */
    ANT_GOVERNED_BAD_INPUT = -1      /* a command is not a number: the previous one replaces it */
};

#endif /* ANTAGONIST_H */
