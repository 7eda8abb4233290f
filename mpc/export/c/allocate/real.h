/* Numbers of either precision: functions of math.h for ant_real, and tolerances of equality under rounding. */
#ifndef ANT_REAL_H
#define ANT_REAL_H

#include <math.h>

#include "antagonist.h"

#ifdef ANT_SINGLE
#define ANT_R(number) number##f     /* a constant */
#define ANT_F(function) function##f /* a function of math.h */
#else
#define ANT_R(number) number
#define ANT_F(function) function
#endif

#define ANT_INFINITY ((ant_real)INFINITY)
#define ANT_NAN ((ant_real)NAN)
#define ANT_PI ANT_R(3.14159265358979323846)

/* A function that is not inlined when optimising for size without an FPU for double: gcc counts floating-point calls as
 * free and would inline it everywhere. */
#if defined(__GNUC__) && defined(__OPTIMIZE_SIZE__) && !defined(ANT_SINGLE)
#define ANT_ONCE static __attribute__((noinline))
#else
#define ANT_ONCE static
#endif

/* x within [lo, hi]; NaN becomes lo; hi if lo > hi */
static inline ant_real ant_clip(ant_real x, ant_real lo, ant_real hi) {
    const ant_real raised = x > lo ? x : lo;
    return raised < hi ? raised : hi;
}

static inline ant_real ant_abs(ant_real x) { return x < 0 ? -x : x; }
/* a == b, of which compilers warn; false for NaN */
static inline int ant_equal(ant_real a, ant_real b) { return a <= b && a >= b; }
static inline int ant_abs_int(int a) { return a < 0 ? -a : a; }
/* the lesser and the greater of two numbers; a if one is NaN */
static inline ant_real ant_min(ant_real a, ant_real b) { return b < a ? b : a; }
static inline ant_real ant_max(ant_real a, ant_real b) { return b > a ? b : a; }
static inline int ant_min_int(int a, int b) { return b < a ? b : a; }
static inline int ant_max_int(int a, int b) { return b > a ? b : a; }

#endif /* ANT_REAL_H */
