/* Memory and workspace of the controller, of fixed size; included by antagonist.h. */
#ifndef ANTAGONIST_CONTROLLER_H
#define ANTAGONIST_CONTROLLER_H

enum { ANT_MOVES = 2 * ANT_BLOCKS }; /* changes of the commands that the QP decides */

/* Numbers that can be tuned while the program runs; src/tuning.c has those of the export. The terminal cost depends on
 * the weights: use sets of numbers from Python, see ant_tuning_from. */
typedef struct {
    ant_real x[4];      /* weights of theta, its rate, P1, P2 */
    ant_real y[3];      /* of the outputs K, F1, F2 */
    ant_real e[2];      /* of the commands away from the feed-forward [1/bar^2] */
    ant_real change[2]; /* and of their changes [1/bar^2] */
    ant_real end[6][6]; /* of xi with commands in bar, the terminal cost is xi^T ... xi/2 */
    ant_real slack[4];  /* prices rho [1/rad], rho_2 [1/rad^2], rho_F [1/N], rho_F2 [1/N^2] of the slacks */
    ant_real curvature; /* that the charge on a change gives the cost [1/bar^2] */
    ant_real step;      /* greatest change of a command in a sample [Pa] */
    ant_real min_force; /* least force of the muscles [N] */
} ant_tuning;
enum { ANT_TUNING_NUMBERS = 2 + sizeof(ant_tuning) / sizeof(ant_real) };

/* Memory of friction. */
typedef struct {
    ant_real memory[ANT_ELEMENTS]; /* z [-] of Dahl's model, or the elements' springs [rad] of Maxwell slip */
    ant_real theta;                /* up to which the joint's motion is in it [rad] */
    int known;
} ant_friction;

/* Estimate of theta [rad], its rate [rad/s], P1, P2 [Pa] and the disturbance torque d [N*m]. */
typedef struct {
    ant_real xi[5];
    ant_real covariance[5][5];
} ant_belief;

/* Verdict on a reading. */
typedef enum {
    ANT_BELIEVED = 0,
    ANT_ACCEPTED = 1,   /* after it had been rejected for long enough */
    ANT_SILENT = 2,     /* no reading */
    ANT_IMPOSSIBLE = 3, /* outside the joint range or the supply */
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

/* The extended Kalman filter behind its gates; sensors are theta, P1, P2. */
typedef struct {
    ant_belief belief;
    ant_verdict verdicts[3];
    ant_gate gates[3];
    int rebuilt;           /* number of times that the state was not finite and was rebuilt */
    ant_belief without[3]; /* estimates without a sensor that repeats itself */
    int repeats[3];        /* whether there is one */
    int frozen[3];
    ant_belief rival;      /* estimate from the rejected readings */
    int rivalled;          /* whether there is one */
    int explained;         /* samples for which it has explained all readings */
    int doubted;           /* samples for which it has to */
    int contested[3];      /* sensors whose readings it explains */
    int unrivalled;        /* samples since anything was rejected */
    int samples;           /* since the beginning, up to ANT_FIRST + 1 */
    ant_real noise[3];     /* variances of the sensors */
    ant_real step;         /* the least change of the angle's reading so far [rad] */
    ant_real read[3];      /* a sample ago */
    ant_real offset[2];    /* of the pressures' sensors against the regulators [Pa] */
    ant_real silent[3];    /* for how long [s] */
    ant_real repeating[3]; /* for how long [s] */
    ant_friction friction;
    ant_real commands[ANT_DELAY + ANT_AGE + 1][2]; /* under way, oldest first [Pa] */
    ant_real held[ANT_AGE + 1][2]; /* readings of pressures until an angle as old comes [Pa] */
    int holds;                     /* whether there are any */
    int begun;
} ant_observer;

/* A motion of the joint under commands. */
typedef struct {
    ant_real u[ANT_HORIZON][2]; /* [Pa] */
    ant_real x[ANT_HORIZON + 1][4];
    ant_real K[ANT_HORIZON + 1];    /* [N*m/rad] */
    ant_real F[ANT_HORIZON + 1][2]; /* [N] */
} ant_motion;

/* Rest mode: statistics of the last quarters of the joint's free period, and the held pressures. */
typedef struct {
    ant_real reference[2];               /* theta [rad] and K [N*m/rad] while they are constant */
    ant_real quarters[4][5];             /* means of the angle's error e [rad], P1, P2 [Pa], least and greatest e */
    ant_real sum[3], low, high;          /* of the quarter that runs */
    ant_real p[2];                       /* pressures that are held [Pa] */
    ant_real began[2];                   /* pressures when the rest began, or as they were corrected [Pa] */
    ant_real side;                       /* edge of the dead band, 1 or -1 */
    ant_real torque, error, free;        /* the last correction [N*m], its error and greatest rotation [rad] */
    ant_real usual; /* how far the angle was from its prediction in the last period or so, without a rest [rad] */
    int samples, quarter, in_sum;        /* of constant preview; of a quarter; in the one that runs */
    int counted, swings, since;          /* quarters seen; in which e swung; since the last correction */
    int known, resting, ringing;
} ant_rest;

/* A preview, and the pressures that it requires. */
typedef struct {
    ant_real x[ANT_HORIZON + 1][4]; /* theta within the joint range [rad], its rate, the pressures [Pa] */
    ant_real y[ANT_HORIZON + 1][3]; /* reachable stiffness nearest to the reference [N*m/rad], no force */
    ant_real u[ANT_HORIZON][2];     /* commands, unlimited [Pa] */
    ant_real moved[3];
    int finite;
} ant_feed;

/* Workspace of the QP: sweeps and exchange; see src/recursions.h. */
typedef struct {
    ant_real x[ANT_HORIZON + 1][4], y[ANT_HORIZON + 1][3], e[ANT_HORIZON][2], change[ANT_HORIZON][2], end[6]; /* errors */
    ant_real lower[ANT_HORIZON + 1][2], upper[ANT_HORIZON + 1][2], low[ANT_HORIZON + 1][2], high[ANT_HORIZON + 1][2];
    ant_real xi[ANT_HORIZON + 1][6], v[ANT_HORIZON][2], sigma[2];
    ant_real R[ANT_HORIZON][2][6], D[ANT_HORIZON][3], g[ANT_HORIZON][2], feedback[ANT_HORIZON][2][7];
    ant_real gx[ANT_HORIZON + 1][6], gv[ANT_HORIZON][2], inverse[ANT_HORIZON][3];
    ant_real by_xi[ANT_HORIZON + 1][6], by_v[ANT_HORIZON][2]; /* differences */
    ant_real z[ANT_HORIZON + 1][2], r[ANT_HORIZON + 1][2], dz[ANT_HORIZON + 1][2], dr[ANT_HORIZON + 1][2];
    ant_real answer[ANT_HORIZON + 1][6];
    ant_real item_z[ANT_ITEMS][ANT_HORIZON + 1][2], item_r[ANT_ITEMS][ANT_HORIZON + 1][2];
    ant_real K[ANT_ITEMS][ANT_ITEMS], L[ANT_ITEMS][ANT_ITEMS], multiplier[ANT_ITEMS], step[ANT_ITEMS];
    ant_real item_p[6];
    int kind[ANT_ITEMS], sample[ANT_ITEMS], muscle[ANT_ITEMS], side[ANT_ITEMS], order[ANT_ITEMS], known[1];
    signed char base[ANT_HORIZON + 1][2], held[ANT_HORIZON + 1][2], guessed[ANT_HORIZON + 1][2], there[ANT_HORIZON];
} ant_work;

/* The QP of a step, sample by sample: its linear model along a motion, and commands in bar. */
typedef struct {
    const ant_tuning *tuning;
    ant_motion motion; /* of no change */
    ant_real u[ANT_HORIZON][2], y[ANT_HORIZON + 1][3];
    ant_real A[ANT_HORIZON][4][4], B[ANT_HORIZON][4][2], slope[ANT_HORIZON + 1][3][4];
    signed char guess[ANT_MOVES]; /* active limits of the changes */
    ant_work work;
} ant_qp;

typedef struct {
    /* Bound of the exchanges in a QP, at most ANT_EXCHANGES; ant_reset sets ANT_EXCHANGES. */
    int exchange_limit;

    ant_observer observer;
    ant_friction friction;
    ant_rest rest;
    ant_real waiting[ANT_DELAY + 1][2]; /* commands as they will act, oldest first [Pa] */
    ant_real sent[2];                   /* [Pa] */
    ant_real expected[4];               /* the state predicted for the next sample */
    ant_real u_star[2];                 /* feed-forward of the last sample [Pa] */
    ant_motion last;                    /* the last plan, its commands as they should act */
    int begun;                          /* there is a last plan */
    int predicted;                      /* there is an expected state */
    int starred;                        /* there is a u_star */
    int seen;                           /* the angle has been measured */
    int blind;                          /* samples since it was */
    int left;                           /* samples to the end of the last plan that was optimised */
    int held;                           /* samples spent on the last rung */

    ant_feed feed;
    ant_motion motion;         /* of the commands that are tried */
    ant_real d[ANT_AHEAD + 1]; /* disturbance and friction torque [N*m] */
    ant_real stay[ANT_AHEAD + 1]; /* the angle, in place of invalid references [rad] */
    ant_qp qp;
} ant_controller;

#endif /* ANTAGONIST_CONTROLLER_H */
