/* Pressures of an antagonistic pneumatic-muscle joint, exported from the Python package `antagonist`.
 *
 * Plain C99: no heap, no global state, nothing but math.h. Everything is in SI units: Pa (gauge), rad, N*m, N, s.
 * Muscle 1 is the agonist, which shortens as the angle theta grows; muscle 2 is the antagonist.
 *
 * No input leads to undefined behaviour: what makes no sense, NaN included, is answered by a status.
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

/* What an allocation can say of itself; where several hold the last of the list from 0 to 10 is given. */
typedef enum {
    ANT_EXACT = 0,               /* torque and stiffness are met */
    ANT_TORQUE_LIMITED = 1,      /* the torque cannot be met, this is the nearest */
    ANT_STIFFNESS_LIMITED = 2,   /* the stiffness cannot be met, this is the nearest */
    ANT_BOTH_LIMITED = 3,        /* neither can be met, this is the best trade for the priority */
    ANT_CONFLICT = 6,            /* limits contradict each other: the supply was kept first, then ceilings */
    ANT_SLACK = 7,               /* no allowed pressure pulls both cables with min_force */
    ANT_OUTSIDE_JOINT_RANGE = 8, /* the angle is beyond the joint range, answered at the nearest inside */
    ANT_OUTSIDE_LIMITS = 10,     /* the slew limit allows nothing within supply, model and max_force */
    ANT_BAD_INPUT = -1,          /* an argument makes no sense: P1 and P2 are a safe guess, do not use the rest */
    ANT_BEYOND_MODEL = -2        /* the pressures in reach are none that the muscle model holds for; likewise */
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

/* What is met first where torque and stiffness cannot both be had. */
typedef enum { ANT_TORQUE_FIRST = 0, ANT_STIFFNESS_FIRST = 1 } ant_priority;

typedef struct {
    ant_real theta;     /* joint angle [rad] */
    ant_real K;         /* stiffness wanted, positive [N*m/rad] */
    ant_real T;         /* torque wanted [N*m] */
    ant_real min_force; /* least muscle force [N]; -INFINITY: cables may be slack */
    ant_real max_force; /* greatest muscle force [N]; INFINITY: no limit */
    ant_real P1_now;    /* pressures now [Pa], for max_step */
    ant_real P2_now;
    ant_real max_step; /* how far each pressure may move from now [Pa]; INFINITY: anywhere */
    ant_priority priority;
} ant_target;

typedef struct {
    ant_real P1, P2; /* the pressures [Pa] */
    ant_real T, K;   /* what they give [N*m], [N*m/rad] */
    ant_status status;
    int limits; /* the limits that bind */
} ant_allocation;

/* A target with cables taut, no other limit on forces or steps, and the torque first. */
ant_target ant_target_of(ant_real theta, ant_real K, ant_real T);

/* The pressures that give torque and stiffness at the angle, or the nearest that the limits allow: the global optimum
 * in closed form, as `allocator.allocate(..., method="exact")`. */
ant_allocation ant_allocate(const ant_target *target);

#ifdef ANT_HORIZON
/* --- control: angle and stiffness to commanded pressures --------------------------------------------------------- */

/* How a plan came about. */
typedef enum {
    ANT_PLAN_OPTIMAL = 0,        /* the QP was solved, and its optimality conditions were checked */
    ANT_PLAN_UNSOLVED = 1,       /* the QP solver gave up, or reached its bound of iterations */
    ANT_PLAN_REFUSED = 2,        /* the QP solver's answer was not optimal and was refused */
    ANT_PLAN_NO_MEASUREMENT = 3, /* part of the state was not measured: the predicted one was used in its place */
    ANT_PLAN_NOT_FINITE = 4,     /* the prediction left the range of numbers */
    ANT_PLAN_BLIND = 7,          /* the angle has not been measured for too long to trust its prediction */
    ANT_PLAN_RESTING = 9,        /* the reference stands still: the pressures are held, and corrected now and then */
    ANT_PLAN_BAD_INPUT = -1      /* a reference makes no sense: the pressures are held */
} ant_plan_status;

/* Which step of the fallback ladder gave the plan, best first. */
typedef enum {
    ANT_RUNG_QP = 0,
    ANT_RUNG_SOFTENED = 1,   /* the QP with its limits softened, all but the slew */
    ANT_RUNG_PREVIOUS = 2,   /* the previous plan went on */
    ANT_RUNG_ALLOCATION = 3, /* the closed-form allocation, approached as the limits allow */
    ANT_RUNG_HOLD = 4        /* the pressures are held, and let out slowly if this lasts */
} ant_rung;

/* What the sensors say; NaN where one is silent. */
typedef struct {
    ant_real theta;  /* [rad] */
    ant_real P1, P2; /* [Pa] */
} ant_reading;

/* What is to be followed, from now on every ANT_DT seconds: ANT_AHEAD + 1 samples. */
typedef struct {
    ant_real theta[ANT_AHEAD + 1]; /* [rad] */
    ant_real K[ANT_AHEAD + 1];     /* [N*m/rad] */
} ant_reference;

/* The commands for the horizon and what they are expected to do. */
typedef struct {
    ant_real u[ANT_HORIZON][2];     /* commanded pressures [Pa]; u[0] is the pair to send now */
    ant_real x[ANT_HORIZON + 1][4]; /* theta [rad], its rate [rad/s], P1, P2 [Pa], from when u[0] is heard */
    ant_real K[ANT_HORIZON + 1];    /* stiffness [N*m/rad] along x */
    ant_plan_status status;
    ant_rung rung;
    ant_real slack;       /* how far x leaves the joint range at worst [rad] */
    ant_real slack_force; /* how far a muscle force falls below the least one at worst [N] */
    ant_real moved[3];    /* how far references were moved at worst: angle [rad], stiffness [N*m/rad], torque [N*m] */
    int iterations;       /* of the QP solver */
} ant_plan;

#include "antagonist_controller.h" /* ant_controller: memory and workspace, all that control needs, of fixed size */

/* Begin anew: to be called once before the first step. */
void ant_reset(ant_controller *controller);

/* One sample: reading and reference in, plan out. Sends nothing: plan->u[0] is meant to be sent now. */
void ant_step(ant_controller *controller, const ant_reading *reading, const ant_reference *reference, ant_plan *plan);

/* Controls with `tuning` from now on, to be called after ant_reset, which goes back to ANT_TUNING; it has to stay where
 * it is. Returns 0, and changes nothing, for one that cannot be: a number that is not finite, a weight or price that is
 * not positive. */
extern const ant_tuning ANT_TUNING; /* the export's */
int ant_tune(ant_controller *controller, const ant_tuning *tuning);

/* Fills in a tuning from the numbers that `antagonist export --tuning` writes. Returns 0, and changes nothing, where
 * their count is not ANT_TUNING_NUMBERS, or where they were made for another sample time or another plant. */
int ant_tuning_from(const ant_real *numbers, int count, ant_tuning *tuning);

/* The two halves of ant_step, for those who have an observer of their own. The state x is theta [rad], its rate
 * [rad/s], P1, P2 [Pa], NaN where unknown; d is the torque from outside [N*m]; sent is what was commanded a sample ago
 * [Pa]. What the observer thinks of the readings is in observer->verdicts. */
void ant_estimate(ant_observer *observer, const ant_reading *reading, const ant_real sent[2], ant_real x[4],
                  ant_real *d);
void ant_control(ant_controller *controller, const ant_real x[4], ant_real d, const ant_reference *reference,
                 ant_plan *plan);
#endif

#ifdef __cplusplus
}
#endif

#endif /* ANTAGONIST_H */
