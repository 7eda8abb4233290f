/* Pressures of a mechanism moved by pneumatic muscles, exported from the Python package `antagonist`.
 *
 * Plain C99 without a heap or global state; it needs only math.h. Everything is in SI units: Pa (gauge), rad, N*m, N.
 * The mechanism has ANT_JOINTS joints and ANT_MUSCLES muscles; stiffness matrices are given by their upper triangles,
 * K11, K12, ..., K22, ..., ANT_STIFFNESSES numbers.
 *
 * No input leads to undefined behaviour: invalid input, NaN included, is answered by a status.
 */
#ifndef ANTAGONIST_H
#define ANTAGONIST_H

#include "antagonist_config.h" /* precision and sizes, chosen at export */

#ifdef __cplusplus
extern "C" {
#endif

#ifdef ANT_SINGLE
typedef float ant_real;
#else
typedef double ant_real;
#endif

/* Status of an allocation. If several apply, the last one in the list from 0 to 10 is given. */
typedef enum {
    ANT_EXACT = 0,               /* torques and stiffness are met */
    ANT_TORQUE_LIMITED = 1,      /* the torques cannot be met, these are the nearest */
    ANT_STIFFNESS_LIMITED = 2,   /* the stiffness cannot be met, this is the nearest */
    ANT_BOTH_LIMITED = 3,        /* neither can be met, this is the best trade for the priority */
    ANT_UNSTABLE = 5,            /* the stiffness is not positive definite: the posture does not hold itself */
    ANT_CONFLICT = 6,            /* limits of a muscle contradict each other: the supply was kept first */
    ANT_SLACK = 7,               /* a muscle has no allowed pressure that pulls with min_force */
    ANT_OUTSIDE_JOINT_RANGE = 8, /* the posture is beyond the joints' range, or stretches a muscle too far */
    ANT_SOLVER_FAILED = 9,       /* the answer is not proved to be optimal; it is within the limits */
    ANT_OUTSIDE_LIMITS = 10,     /* the slew limit allows nothing within supply, model and max_force */
    ANT_BAD_INPUT = -1           /* an argument is invalid: P is a safe guess, do not use the rest */
} ant_status;

/* Which target is met first if torques and stiffness cannot both be met. */
typedef enum { ANT_TORQUE_FIRST = 0, ANT_STIFFNESS_FIRST = 1 } ant_priority;

typedef struct {
    ant_real q[ANT_JOINTS];      /* posture [rad] */
    ant_real T[ANT_JOINTS];      /* desired torques [N*m] */
    ant_real K[ANT_STIFFNESSES]; /* desired stiffness [N*m/rad]; NAN: any */
    ant_real min_force;          /* least muscle force [N]; -INFINITY: cables may be slack */
    ant_real max_force;          /* greatest muscle force [N]; INFINITY: no limit */
    ant_real P_now[ANT_MUSCLES]; /* pressures now [Pa], for max_step and nearest */
    ant_real max_step;           /* greatest change of each pressure [Pa]; INFINITY: no limit */
    int nearest;                 /* of equally good pressures: 0 the least, 1 those nearest to P_now */
    int follow;                  /* 1: start from the last active limits; the answer is the same, but faster */
    ant_priority priority;
} ant_target;

typedef struct {
    ant_real P[ANT_MUSCLES];     /* the pressures [Pa] */
    ant_real T[ANT_JOINTS];      /* torques at P [N*m] */
    ant_real K[ANT_STIFFNESSES]; /* [N*m/rad] */
    ant_real residual;           /* of optimality, in fractions of its scale */
    ant_status status;
    int rounds; /* number of guesses, 0 if none was right */
} ant_allocation;

#include "antagonist_memory.h" /* ant_memory: memory of a call, of fixed size */

/* A target with cables taut, no other limit, the torques first, and every entry of K free. */
ant_target ant_target_of(const ant_real q[ANT_JOINTS], const ant_real T[ANT_JOINTS]);

/* The pressures that give torques and stiffness at the posture, or the nearest that the limits allow: the global
 * optimum, as `allocator.allocate`. `memory` should be static; it may start as zeros. */
void ant_allocate(const ant_target *target, ant_memory *memory, ant_allocation *allocation);

#ifdef ANT_HORIZON
#include "antagonist_control.h"
#endif

#ifdef __cplusplus
}
#endif

#endif /* ANTAGONIST_H */
