/* Memory and workspace of the controller, of fixed size; included by antagonist.h. */
#ifndef ANTAGONIST_CONTROLLER_H
#define ANTAGONIST_CONTROLLER_H

#include "src/resting.h" /* ant_rest: memory of the rest mode */

enum { ANT_MOVES = ANT_MUSCLES * ANT_BLOCKS }; /* changes of the commands that the QP decides */

/* Numbers that can be tuned while the program runs; src/tuning.c has those of the export. The terminal cost depends on
 * the weights: use sets of numbers from Python, see ant_tuning_from. */
typedef struct {
    ant_real x[ANT_STATES];       /* weights of the states; of an arm's pressures [1/bar^2] */
    ant_real y[ANT_OUTPUTS];      /* of the outputs: stiffness and forces */
    ant_real e[ANT_MUSCLES];      /* of the commands away from the feed-forward [1/bar^2] */
    ant_real change[ANT_MUSCLES]; /* and of their changes [1/bar^2] */
    ant_real end[ANT_XI][ANT_XI]; /* of xi with commands in bar, the terminal cost is xi^T ... xi/2 */
    ant_real slack[4];            /* prices rho [1/rad], rho_2 [1/rad^2], rho_F [1/N], rho_F2 [1/N^2] of the slacks */
    ant_real curvature;           /* that the charge on a change gives the cost [1/bar^2] */
    ant_real step;                /* greatest change of a command in a sample [Pa] */
    ant_real min_force;           /* least force of the muscles [N] */
} ant_tuning;
enum { ANT_TUNING_NUMBERS = 2 + sizeof(ant_tuning) / sizeof(ant_real) };

/* Memory of a joint's friction. */
typedef struct {
    ant_real memory[ANT_ELEMENTS]; /* z [-] of Dahl's model, or the elements' springs [rad] of Maxwell slip */
    ant_real theta;                /* up to which the joint's motion is in it [rad] */
    int known;
} ant_friction;

/* Estimate of the angles [rad], their rates [rad/s], the pressures [Pa] and the disturbance torques [N*m]. */
typedef struct {
    ant_real xi[ANT_BELIEFS];
    ant_real covariance[ANT_BELIEFS][ANT_BELIEFS];
} ant_belief;

/* Verdict on a reading. */
typedef enum {
    ANT_BELIEVED = 0,
    ANT_ACCEPTED = 1,   /* after it had been rejected for long enough */
    ANT_SILENT = 2,     /* no reading */
    ANT_IMPOSSIBLE = 3, /* outside the joint ranges or the supply */
    ANT_REJECTED = 4,   /* too far from the expected value */
    ANT_FROZEN = 5      /* the sensor repeats itself although the joint moves */
} ant_verdict;

/* The gate of one sensor. */
typedef struct {
    ant_real floor;   /* a reading this near to the expected one is accepted */
    ant_real width;   /* at the first of consecutive rejections */
    int since;        /* samples since that one, itself included; 0: there are none */
    ant_real refused; /* the last reading that was rejected or frozen, or NaN */
} ant_gate;

/* The extended Kalman filter behind its gates; sensors are those of the angles and of the pressures. */
typedef struct {
    ant_belief belief;
    ant_verdict verdicts[ANT_SENSORS];
    ant_gate gates[ANT_SENSORS];
    int rebuilt;                     /* number of times that the state was not finite and was rebuilt */
    ant_belief without[ANT_SENSORS]; /* estimates without a sensor that repeats itself */
    int repeats[ANT_SENSORS];        /* whether there is one */
    int frozen[ANT_SENSORS];
    ant_belief rival;           /* estimate from the rejected readings */
    int rivalled;               /* whether there is one */
    int explained;              /* samples for which it has explained all readings */
    int doubted;                /* samples for which it has to */
    int contested[ANT_SENSORS]; /* sensors whose readings it explains */
    int unrivalled;             /* samples since anything was rejected */
    int samples;                /* since the beginning, up to ANT_FIRST + 1 */
    ant_real noise[ANT_SENSORS];     /* variances of the sensors */
    ant_real step[ANT_JOINTS];       /* the least change of each angle's reading so far [rad] */
    ant_real read[ANT_SENSORS];      /* a sample ago */
    ant_real offset[ANT_MUSCLES];    /* of the pressures' sensors against the regulators [Pa] */
    ant_real apart[2][ANT_MUSCLES];  /* of quick and of slow regulators from the model's [Pa] */
    ant_real silent[ANT_SENSORS];    /* for how long [s] */
    ant_real repeating[ANT_SENSORS]; /* for how long [s] */
    ant_friction friction[ANT_JOINTS];
    ant_real commands[ANT_DELAY + ANT_AGE + 1][ANT_MUSCLES]; /* under way, oldest first [Pa] */
    ant_real held[ANT_AGE + 1][ANT_MUSCLES]; /* readings of pressures until angles as old come [Pa] */
    int holds;                               /* whether there are any */
    int begun;
} ant_observer;

/* A motion under commands. */
typedef struct {
    ant_real u[ANT_HORIZON][ANT_MUSCLES]; /* [Pa] */
    ant_real x[ANT_HORIZON + 1][ANT_STATES];
    ant_real K[ANT_HORIZON + 1][ANT_STIFFNESSES]; /* entries times ANT_SVEC [N*m/rad] */
    ant_real F[ANT_HORIZON + 1][ANT_MUSCLES];     /* [N] */
} ant_motion;

/* A preview, and the pressures that it requires. */
typedef struct {
    ant_real x[ANT_HORIZON + 1][ANT_STATES]; /* angles within their ranges [rad], rates, the pressures [Pa] */
    ant_real y[ANT_HORIZON + 1][ANT_OUTPUTS]; /* reachable stiffness nearest to the reference [N*m/rad], no force */
    ant_real u[ANT_HORIZON][ANT_MUSCLES];     /* commands, unlimited [Pa] */
    ant_real moved[3];
    int finite;
    ant_memory memory; /* of the allocation */
} ant_feed;

#ifdef ANT_ARM /* a pressure depends only on its own command, but there may be any number */
typedef ant_real ant_square[ANT_MUSCLES][ANT_MUSCLES];
#else
typedef ant_real ant_square[3]; /* entries 00, 01, 11 */
#endif

/* Workspace of the QP: sweeps and exchange; see src/recursions.h. */
typedef struct {
    ant_real x[ANT_HORIZON + 1][ANT_STATES], y[ANT_HORIZON + 1][ANT_OUTPUTS]; /* errors */
    ant_real e[ANT_HORIZON][ANT_MUSCLES], change[ANT_HORIZON][ANT_MUSCLES], end[ANT_XI];
    ant_real lower[ANT_HORIZON + 1][ANT_MUSCLES], upper[ANT_HORIZON + 1][ANT_MUSCLES];
    ant_real low[ANT_HORIZON + 1][ANT_MUSCLES], high[ANT_HORIZON + 1][ANT_MUSCLES];
    ant_real xi[ANT_HORIZON + 1][ANT_XI], v[ANT_HORIZON][ANT_MUSCLES], sigma[2];
    ant_real R[ANT_HORIZON][ANT_MUSCLES][ANT_XI], g[ANT_HORIZON][ANT_MUSCLES];
    ant_square D[ANT_HORIZON], inverse[ANT_HORIZON];
    ant_real feedback[ANT_HORIZON][ANT_MUSCLES][ANT_XI + 1];
    ant_real gx[ANT_HORIZON + 1][ANT_XI], gv[ANT_HORIZON][ANT_MUSCLES];
    ant_real by_xi[ANT_HORIZON + 1][ANT_XI], by_v[ANT_HORIZON][ANT_MUSCLES]; /* differences */
    ant_real command_charge[ANT_HORIZON][ANT_MUSCLES], change_charge[ANT_HORIZON][ANT_MUSCLES];
    ant_real row_charge[ANT_HORIZON + 1][ANT_JOINTS + ANT_MUSCLES];
    ant_real z[ANT_HORIZON + 1][ANT_MUSCLES], r[ANT_HORIZON + 1][ANT_MUSCLES];
    ant_real dz[ANT_HORIZON + 1][ANT_MUSCLES], dr[ANT_HORIZON + 1][ANT_MUSCLES];
    ant_real answer[ANT_HORIZON + 1][ANT_XI];
    ant_real item_z[ANT_ITEMS][ANT_HORIZON + 1][ANT_MUSCLES], item_r[ANT_ITEMS][ANT_HORIZON + 1][ANT_MUSCLES];
    ant_real K[ANT_ITEMS][ANT_ITEMS], L[ANT_ITEMS][ANT_ITEMS], multiplier[ANT_ITEMS], step[ANT_ITEMS];
    ant_real item_p[ANT_XI];
    int kind[ANT_ITEMS], sample[ANT_ITEMS], muscle[ANT_ITEMS], side[ANT_ITEMS], order[ANT_ITEMS], known[1];
    signed char base[ANT_HORIZON + 1][ANT_MUSCLES], held[ANT_HORIZON + 1][ANT_MUSCLES];
    signed char guessed[ANT_HORIZON + 1][ANT_MUSCLES], there[ANT_HORIZON];
} ant_qp_memory;

/* The QP of a step, sample by sample: its linear model along a motion, and commands in bar. Of an arm the pressures count
 * in bar too: A is of the next state by the state and the command, without gas of the next angles and rates. */
typedef struct {
    const ant_tuning *tuning;
    ant_motion motion; /* of no change */
    ant_real u[ANT_HORIZON][ANT_MUSCLES], y[ANT_HORIZON + 1][ANT_OUTPUTS];
#ifdef ANT_ARM
    ant_real A[ANT_HORIZON][ANT_MOVING][ANT_XI];
#else
    ant_real A[ANT_HORIZON][ANT_STATES][ANT_STATES], B[ANT_HORIZON][ANT_STATES][ANT_MUSCLES];
#endif
    ant_real slope[ANT_HORIZON + 1][ANT_OUTPUTS][ANT_STATES];
    signed char guess[ANT_MOVES]; /* active limits of the changes */
    ant_qp_memory work;
} ant_qp;

typedef struct {
    /* Bound of the exchanges in a QP, at most ANT_EXCHANGES; ant_reset sets ANT_EXCHANGES. */
    int exchange_limit;

    ant_observer observer;
    ant_friction friction[ANT_JOINTS];
    ant_rest rest;
    ant_real waiting[ANT_DELAY + 1][ANT_MUSCLES]; /* commands as they will act, oldest first [Pa] */
    ant_real sent[ANT_MUSCLES];                   /* [Pa] */
    ant_real expected[ANT_STATES];                /* the state predicted for the next sample */
    ant_real u_star[ANT_MUSCLES];                 /* feed-forward of the last sample [Pa] */
    ant_motion last;                              /* the last plan, its commands as they should act */
    int begun;                          /* there is a last plan */
    int predicted;                      /* there is an expected state */
    int starred;                        /* there is a u_star */
    int seen;                           /* the angles have been measured */
    int blind;                          /* samples since it was */
    int left;                           /* samples to the end of the last plan that was optimised */
    int held;                           /* samples spent on the last rung */

    ant_feed feed;
    ant_motion motion;                        /* of the commands that are tried */
    ant_real d[ANT_AHEAD + 1][ANT_JOINTS];    /* disturbance and friction torques [N*m] */
    ant_real stay[ANT_AHEAD + 1][ANT_JOINTS]; /* the angles, in place of invalid references [rad] */
    ant_qp qp;
} ant_controller;

#endif /* ANTAGONIST_CONTROLLER_H */
