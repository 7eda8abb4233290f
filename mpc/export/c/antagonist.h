/* Pressures of an antagonistic pneumatic-muscle joint, exported from the Python package `antagonist`.
 *
 * Plain C99 without a heap or global state; it needs only math.h. Units are SI: Pa (gauge), rad, N*m, N, s.
 * Muscle 1 is the agonist, which shortens as the angle theta grows; muscle 2 is the antagonist.
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

/* --- allocation: torque and stiffness to pressures --------------------------------------------------------------- */

/* Status of an allocation. If several apply, the last one in the list from 0 to 10 is given. */
typedef enum {
    ANT_EXACT = 0,               /* torque and stiffness are met */
    ANT_TORQUE_LIMITED = 1,      /* the torque cannot be met, this is the nearest */
    ANT_STIFFNESS_LIMITED = 2,   /* the stiffness cannot be met, this is the nearest */
    ANT_BOTH_LIMITED = 3,        /* neither can be met, this is the best trade for the priority */
    ANT_CONFLICT = 6,            /* limits contradict each other: the supply was kept first, then ceilings */
    ANT_SLACK = 7,               /* no allowed pressure pulls both cables with min_force */
    ANT_OUTSIDE_JOINT_RANGE = 8, /* the angle is beyond the joint range, answered at the nearest inside */
    ANT_OUTSIDE_LIMITS = 10,     /* the slew limit allows nothing within supply, model and max_force */
    ANT_BAD_INPUT = -1,          /* an argument is invalid: P1 and P2 are a safe guess, do not use the rest */
    ANT_BEYOND_MODEL = -2        /* the muscle model is invalid at all reachable pressures; likewise */
} ant_status;

/* Limits that an answer lies on; `limits` is a combination of them. */
enum {
    ANT_P1_LOWER = 1, /* supply, P1 */
    ANT_P1_UPPER = 2,
    ANT_P2_LOWER = 4, /* supply, P2 */
    ANT_P2_UPPER = 8,
    ANT_AGONIST_SLACK = 16, /* min_force */
    ANT_ANTAGONIST_SLACK = 32,
    ANT_P1_RATE = 64, /* max_step */
    ANT_P2_RATE = 128,
    ANT_AGONIST_VALIDITY = 256, /* of the muscle model */
    ANT_ANTAGONIST_VALIDITY = 512,
    ANT_JOINT_RANGE = 1024, /* end stops */
    ANT_CONTRACTION_THRESHOLD = 2048,
    ANT_AGONIST_FORCE = 4096, /* max_force */
    ANT_ANTAGONIST_FORCE = 8192
};

/* Which target is met first if torque and stiffness cannot both be met. */
typedef enum { ANT_TORQUE_FIRST = 0, ANT_STIFFNESS_FIRST = 1 } ant_priority;

typedef struct {
    ant_real theta;     /* joint angle [rad] */
    ant_real K;         /* desired stiffness, positive [N*m/rad] */
    ant_real T;         /* desired torque [N*m] */
    ant_real min_force; /* least muscle force [N]; -INFINITY: cables may be slack */
    ant_real max_force; /* greatest muscle force [N]; INFINITY: no limit */
    ant_real P1_now;    /* pressures now [Pa], for max_step */
    ant_real P2_now;
    ant_real max_step; /* greatest change of each pressure [Pa]; INFINITY: no limit */
    ant_priority priority;
} ant_target;

typedef struct {
    ant_real P1, P2; /* the pressures [Pa] */
    ant_real T, K;   /* torque and stiffness at P1 and P2 [N*m], [N*m/rad] */
    ant_status status;
    int limits; /* the limits that bind */
} ant_allocation;

/* A target with cables taut, no other limit on forces or steps, and the torque first. */
ant_target ant_target_of(ant_real theta, ant_real K, ant_real T);

/* The pressures that give torque and stiffness at the angle, or the nearest that the limits allow: the global optimum
 * in closed form, as `allocator.allocate(..., method="exact")`. */
ant_allocation ant_allocate(const ant_target *target);

/* --- stiffness: what a push of the joint meets ------------------------------------------------------------------- */

/* Terms of the stiffness [N*m/rad]. A push by +-amplitude with pressures held meets K + hysteresis; shut valves of a
 * muscle add its gas, and regulators with the lag tau, at f Hz, the share s = w/(1 + w) of it with w = (2 pi f tau)^2. */
typedef struct {
    ant_real K;          /* isobaric stiffness: the slope of the backbone */
    ant_real hysteresis; /* secant of the joint's hysteresis or friction at this amplitude */
    ant_real gas[2];     /* trapped gas of both muscles; NaN if the volume of a muscle is unknown */
    ant_real loss;       /* loss stiffness of the hysteresis, work per cycle over pi amplitude^2 */
} ant_stiffness;

/* The stiffness at an angle [rad] and two pressures [Pa] against pushes by +-amplitude [rad], as
 * `AntagonistJoint.stiffness(theta, P1, P2, amplitude=...)`. All terms are NaN for invalid input. */
ant_stiffness ant_stiffness_at(ant_real theta, ant_real P1, ant_real P2, ant_real amplitude);

#ifdef ANT_HORIZON
typedef char ant_memory; /* the allocation needs none */
#include "antagonist_control.h"
#endif

#ifdef __cplusplus
}
#endif

#endif /* ANTAGONIST_H */
