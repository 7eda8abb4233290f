/* Control: angles and stiffness to commanded pressures; included by antagonist.h. */
#ifndef ANTAGONIST_CONTROL_H
#define ANTAGONIST_CONTROL_H

enum {
    ANT_SENSORS = ANT_JOINTS + ANT_MUSCLES,
    ANT_STATES = 2 * ANT_JOINTS + ANT_MUSCLES,     /* angles, their rates, pressures */
    ANT_BELIEFS = ANT_STATES + ANT_JOINTS,         /* and disturbance torques, as the observer estimates them */
    ANT_OUTPUTS = ANT_STIFFNESSES + ANT_MUSCLES,   /* entries of the stiffness, muscle forces */
    ANT_XI = ANT_STATES + ANT_MUSCLES              /* states and the last commands, in the QP */
};

/* Status of a plan. */
typedef enum {
    ANT_PLAN_OPTIMAL = 0,        /* the QP was solved, and its optimality conditions were checked */
    ANT_PLAN_UNSOLVED = 1,       /* the QP's bound of exchanges was reached, see `gap` */
    ANT_PLAN_NO_MEASUREMENT = 3, /* part of the state was not measured: the predicted one was used in its place */
    ANT_PLAN_NOT_FINITE = 4,     /* the prediction left the range of numbers */
    ANT_PLAN_BLIND = 7,          /* the angle has not been measured for too long to trust its prediction */
    ANT_PLAN_RESTING = 9,        /* the reference stands still: the pressures are held, and corrected now and then */
    ANT_PLAN_BAD_INPUT = -1      /* a reference is invalid: the pressures are held */
} ant_plan_status;

/* Which step of the fallback ladder gave the plan, best first. */
typedef enum {
    ANT_RUNG_QP = 0,
    ANT_RUNG_SOFTENED = 1,   /* commands within slew and supply that are not proved optimal */
    ANT_RUNG_PREVIOUS = 2,   /* the previous plan went on */
    ANT_RUNG_ALLOCATION = 3, /* the closed-form allocation, approached as the limits allow */
    ANT_RUNG_HOLD = 4        /* the pressures are held, and let out slowly if this lasts */
} ant_rung;

/* Sensor readings; NaN if one is missing. */
typedef struct {
    ant_real theta[ANT_JOINTS]; /* [rad] */
    ant_real P[ANT_MUSCLES];    /* [Pa] */
} ant_reading;

/* References from now on, every ANT_DT seconds: ANT_AHEAD + 1 samples. */
typedef struct {
    ant_real theta[ANT_AHEAD + 1][ANT_JOINTS];  /* [rad] */
    ant_real K[ANT_AHEAD + 1][ANT_STIFFNESSES]; /* upper triangle K11, K12, ..., K22, ... [N*m/rad] */
} ant_reference;

/* Commands over the horizon, and the predicted motion. */
typedef struct {
    ant_real u[ANT_HORIZON][ANT_MUSCLES];         /* commanded pressures [Pa]; u[0] are those to send now */
    ant_real x[ANT_HORIZON + 1][ANT_STATES];      /* angles [rad], rates [rad/s], pressures [Pa], from when u[0] acts */
    ant_real K[ANT_HORIZON + 1][ANT_STIFFNESSES]; /* stiffness [N*m/rad] along x */
    ant_plan_status status;
    ant_rung rung;
    ant_real slack;       /* how far x leaves the joint ranges at worst [rad] */
    ant_real slack_force; /* how far a muscle force falls below the least one at worst [N] */
    ant_real moved[3];    /* how far references were moved at worst: angle [rad], stiffness [N*m/rad], torque [N*m] */
    ant_real gap;         /* bound of the cost of the commands minus that of the QP's solution; 0 if proved */
    int exchanges;        /* of the QP */
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

/* The two halves of ant_step, for use with another observer. The state x is angles [rad], rates [rad/s], pressures [Pa],
 * NaN where unknown; d are the disturbance torques [N*m]; sent are the previous commands [Pa]. observer->verdicts has
 * the verdicts on the readings. */
void ant_estimate(ant_observer *observer, const ant_reading *reading, const ant_real sent[ANT_MUSCLES],
                  ant_real x[ANT_STATES], ant_real d[ANT_JOINTS]);
void ant_control(ant_controller *controller, const ant_real x[ANT_STATES], const ant_real d[ANT_JOINTS],
                 const ant_reference *reference, ant_plan *plan);

#endif /* ANTAGONIST_CONTROL_H */
