/* A governor of the pressures of pneumatic muscles, exported from the Python package `antagonist`.
 *
 * Plain C99: no heap, no global state, nothing but math.h. Everything is in SI units: Pa (gauge), rad, N*m, N.
 * The mechanism has ANT_JOINTS joints and ANT_MUSCLES muscles. Include antagonist_memory.h, too, for the memory.
 *
 * No input leads to undefined behaviour: what makes no sense, NaN included, is answered by a status.
 */
#ifndef ANTAGONIST_H
#define ANTAGONIST_H

#include "antagonist_config.h" /* precision and sizes, chosen at export */

#ifdef ANT_SINGLE
typedef float ant_real;
#else
typedef double ant_real;
#endif

/* What became of a command; where several hold the last but for ANT_BAD_INPUT. */
enum {
    ANT_GOVERNED_SAFE = 0,           /* unchanged */
    ANT_GOVERNED_MOVED = 1,          /* moved to pressures that keep all limits */
    ANT_GOVERNED_NOT_KEPT = 2,       /* nothing is sure to keep the joint range or the energy */
    ANT_GOVERNED_CONFLICT = 5,       /* the limits of a muscle contradict each other: the supply was kept first */
    ANT_GOVERNED_SLACK = 6,          /* a muscle can have no pressure that keeps it taut */
    ANT_GOVERNED_OUTSIDE_LIMITS = 9, /* the slew leaves a muscle no pressure in its supply */
    ANT_GOVERNED_BAD_INPUT = -1      /* a command is no number: the previous one is in its place */
};

#endif /* ANTAGONIST_H */
