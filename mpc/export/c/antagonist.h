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
/* --- control: angle and stiffness to commanded pressures --------------------------------------------------------- */

/* Status of a plan. */
typedef enum {
    ANT_PLAN_OPTIMAL = 0,        /* the QP was solved, and its optimality conditions were checked */
    ANT_PLAN_UNSOLVED = 1,       /* the QP solver gave up, or reached its bound of iterations */
    ANT_PLAN_REFUSED = 2,        /* the QP solver's answer was not optimal and was refused */
    ANT_PLAN_NO_MEASUREMENT = 3, /* part of the state was not measured: the predicted one was used in its place */
    ANT_PLAN_NOT_FINITE = 4,     /* the prediction left the range of numbers */
    ANT_PLAN_BLIND = 7,          /* the angle has not been measured for too long to trust its prediction */
    ANT_PLAN_RESTING = 9,        /* the reference stands still: the pressures are held, and corrected now and then */
    ANT_PLAN_BAD_INPUT = -1      /* a reference is invalid: the pressures are held */
} ant_plan_status;

/* Which step of the fallback ladder gave the plan, best first. */
typedef enum {
    ANT_RUNG_QP = 0,
    ANT_RUNG_SOFTENED = 1,   /* the QP with its limits softened, all but the slew */
    ANT_RUNG_PREVIOUS = 2,   /* the previous plan went on */
    ANT_RUNG_ALLOCATION = 3, /* the closed-form allocation, approached as the limits allow */
    ANT_RUNG_HOLD = 4        /* the pressures are held, and let out slowly if this lasts */
} ant_rung;

/* Sensor readings; NaN if one is missing. */
typedef struct {
    ant_real theta;  /* [rad] */
    ant_real P1, P2; /* [Pa] */
} ant_reading;

/* References from now on, every ANT_DT seconds: ANT_AHEAD + 1 samples. */
typedef struct {
    ant_real theta[ANT_AHEAD + 1]; /* [rad] */
    ant_real K[ANT_AHEAD + 1];     /* [N*m/rad] */
} ant_reference;

/* Commands over the horizon, and the predicted motion. */
typedef struct {
    ant_real u[ANT_HORIZON][2];     /* commanded pressures [Pa]; u[0] is the pair to send now */
    ant_real x[ANT_HORIZON + 1][4]; /* theta [rad], its rate [rad/s], P1, P2 [Pa], from the time that u[0] acts */
    ant_real K[ANT_HORIZON + 1];    /* stiffness [N*m/rad] along x */
    ant_plan_status status;
    ant_rung rung;
    ant_real slack;       /* how far x leaves the joint range at worst [rad] */
    ant_real slack_force; /* how far a muscle force falls below the least one at worst [N] */
    ant_real moved[3];    /* how far references were moved at worst: angle [rad], stiffness [N*m/rad], torque [N*m] */
    int iterations;       /* of the QP solver */
} ant_plan;

#include "antagonist_controller.h" /* ant_controller: memory and workspace, of fixed size */

/* Reset the controller. Call once before the first step. */
void ant_reset(ant_controller *controller);

/* One sample: reading and reference in, plan out. Sends nothing; the caller sends plan->u[0] at once. */
void ant_step(ant_controller *controller, const ant_reading *reading, const ant_reference *reference, ant_plan *plan);

/* Use `tuning` from now on. Call after ant_reset, which restores ANT_TUNING. `tuning` must stay valid at its address.
 * Returns 0, and changes nothing, if a number is not finite, or a weight or price is not positive. */
extern const ant_tuning ANT_TUNING; /* of the export */
int ant_tune(ant_controller *controller, const ant_tuning *tuning);

/* Fill in a tuning from the numbers that `antagonist export tuning` writes. Returns 0, and changes nothing, if their
 * count is not ANT_TUNING_NUMBERS, or if they were made for another sample time or another plant. */
int ant_tuning_from(const ant_real *numbers, int count, ant_tuning *tuning);

/* The two halves of ant_step, for use with another observer. The state x is theta [rad], its rate [rad/s], P1, P2 [Pa],
 * NaN where unknown; d is the disturbance torque [N*m]; sent are the previous commands [Pa]. observer->verdicts has the
 * verdicts on the readings. */
void ant_estimate(ant_observer *observer, const ant_reading *reading, const ant_real sent[2], ant_real x[4],
                  ant_real *d);
void ant_control(ant_controller *controller, const ant_real x[4], ant_real d, const ant_reference *reference,
                 ant_plan *plan);
#endif

#ifdef __cplusplus
}
#endif

#endif /* ANTAGONIST_H */
