/* The pieces of a step, each in the file of its name. */
#ifndef ANT_CONTROL_H
#define ANT_CONTROL_H

#include "antagonist.h"
#include "real.h"
#include "recursions.h"
#include "settings.h"

/* friction.c */
typedef struct {
    ant_real strength, scale; /* factors of the memory's torque and of its widths */
} ant_contact;
void ant_contacts_at(const ant_real x[ANT_STATES], ant_contact contacts[ANT_JOINTS]);
void ant_friction_follow(ant_friction *f, int joint, ant_real theta, ant_contact c); /* to theta */
void ant_friction_move(ant_real memory[ANT_ELEMENTS], int joint, ant_real motion, ant_contact c); /* motion [rad] */
ant_real ant_friction_torque(const ant_real memory[ANT_ELEMENTS], int joint, ant_contact c);      /* [N*m] */
ant_real ant_after_dead_band(ant_real u, ant_real P);   /* command less the dead band [Pa] */
ant_real ant_inverse_dead_band(ant_real v, ant_real P); /* its inverse, smooth [Pa] */

/* gating.c: which readings are accepted */
void ant_gate_reset(ant_gate *g);
void ant_gate_frozen(ant_gate *g, ant_real read); /* the sensor is frozen at this reading */
ant_verdict ant_first_verdict(int sensor, ant_real read); /* by the range of the sensor alone */
ant_verdict ant_check_reading(ant_gate *g, int sensor, ant_real read, ant_real least, ant_real most, ant_real variance);
ant_real ant_gate_width(const ant_gate *g, ant_real variance);                     /* greatest deviation of a reading */
ant_real ant_unwrapped(ant_real theta, ant_real expected, ant_real within); /* without whole turns, if that is near */

/* filter.c: xi = (q, rates, P, d) */
static inline int ant_measured(int sensor) { return sensor < ANT_JOINTS ? sensor : ANT_JOINTS + sensor; } /* in xi */
void ant_within(ant_real xi[ANT_BELIEFS]); /* to the nearest possible state */
/* Command that moves the model's regulator at P as u moves a muscle's, with its dead band and flow [Pa]. */
ant_real ant_acting(int muscle, ant_real u, ant_real P);
/* In the nearest state within the range of the muscle formulas. */
void ant_contacts_of(const ant_belief *b, ant_contact contacts[ANT_JOINTS]);
/* By the k-th commands. */
void ant_predict_belief(const ant_observer *o, ant_belief *b, int k, const ant_real Q[ANT_BELIEFS]);
void ant_correct(const ant_observer *o, ant_belief *b, const ant_real read[ANT_SENSORS], const int there[ANT_SENSORS]);
ant_real ant_foreseen(const ant_belief *b, int sensor);
ant_real ant_innovation_variance(const ant_observer *o, const ant_belief *b, int sensor);
int ant_sound(const ant_belief *b); /* finite, and no variance negative */
/* At the readings, with great variance. */
void ant_unsure(ant_belief *b, const ant_real read[ANT_SENSORS], const int there[ANT_SENSORS]);

/* A measured pressure as an initial command. A gauge may read below zero; NaN becomes the least command. */
static inline ant_real ant_commandable(ant_real P) {
    const ant_real least = ANT_SUPPLY_LO < 0 ? ANT_SUPPLY_LO : 0;
    return P > least ? P : least;
}

/* Move commands within the slew limit and the supply. */
static inline void ant_limited(ant_real step, const ant_real u_last[ANT_MUSCLES],
                               ant_real u[ANT_HORIZON][ANT_MUSCLES]) {
    ant_limit(ANT_SUPPLY_LO, ANT_SUPPLY_HI, step, u_last, 1, u);
}

/* rollout.c */
int ant_finite(const ant_real *numbers, int n);
/* Under m->u; whether all is finite. */
int ant_rollout(const ant_real x0[ANT_STATES], const ant_real (*d)[ANT_JOINTS], ant_motion *m);

/* preview.c: the time at which a command acts, and the friction then */
typedef struct {
    ant_real x[ANT_STATES];                                /* the state then */
    const ant_real (*theta)[ANT_JOINTS], (*d)[ANT_JOINTS]; /* ANT_HORIZON + 1 samples from then on */
    const ant_real (*K)[ANT_STIFFNESSES];                  /* the same */
    int measured;                                          /* whether all of the state was */
    ant_real seen[ANT_STATES];                             /* the state now, where measured */
    ant_real expected[ANT_JOINTS];                         /* angles predicted for now [rad]; NaN at first */
    int lost;                                              /* whether the angles have been missing for too long */
    int refused; /* whether the references are invalid: theta and K are substitutes */
} ant_task;
void ant_preview(ant_controller *c, const ant_real x[ANT_STATES], const ant_real d[ANT_JOINTS], const ant_reference *r,
                 ant_task *task);
void ant_send(ant_controller *c, ant_plan *plan, ant_real side); /* side: of the dead band, 0 if unknown */

/* rest.c */
int ant_rest_follow(ant_rest *r, const ant_task *task); /* at every sample: whether to rest */

/* feedforward.c */
void ant_feed_forward(const ant_task *task, ant_real min_force, ant_feed *feed);

/* held.c: pressures for stiffness and torques at a posture, what these lack, and the stiffness; whether they exist */
int ant_held(const ant_real q[ANT_JOINTS], const ant_real K[ANT_STIFFNESSES], const ant_real T[ANT_JOINTS],
             ant_real min_force, ant_memory *memory, ant_real P[ANT_MUSCLES], ant_real left[ANT_JOINTS],
             ant_real given[ANT_STIFFNESSES]);
int ant_positive_definite(const ant_real *K);

/* path.c: the linear model along the motion of the last plan, as recursions.c takes it */
int ant_linearise(ant_controller *c, const ant_task *task); /* whether all is finite */
ant_qp_bounds ant_bounds_of(const ant_tuning *tuning);
ant_qp_path ant_path_of(const ant_qp *qp);
void ant_in_units(ant_qp_memory *work); /* errors from those of states to those of the model */

/* structured.c: the QP of a step, sample by sample */
ant_qp_setting ant_setting_of(const ant_tuning *tuning);
void ant_expect_shifted(ant_controller *c); /* the active limits of the last QP, one sample earlier */
/* Sets the solution, or changes within slew and supply; counts in plan. */
ant_plan_status ant_solve(ant_controller *c, const ant_real u_last[ANT_MUSCLES], ant_real z[ANT_MOVES],
                          ant_plan *plan);

/* fallback.c */
void ant_shift(const ant_controller *c, const ant_real u_last[ANT_MUSCLES], ant_real u[ANT_HORIZON][ANT_MUSCLES]);
void ant_hold(const ant_controller *c, const ant_real u_last[ANT_MUSCLES], ant_real u[ANT_HORIZON][ANT_MUSCLES]);
void ant_remember(ant_controller *c, ant_rung rung);

#endif /* ANT_CONTROL_H */
