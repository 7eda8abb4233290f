/* A plant for tests of controllers, as in `mpc.RealPlant` or `mpc.RealArm`; in double precision with any controller. */
#ifndef ANT_PLANT_H
#define ANT_PLANT_H

#include "plant_numbers.h"

enum {
    ANT_PLANT_QUEUE = ANT_PLANT_WAITING + 1, /* the commands on their way, and one more that has just been given */
    ANT_PLANT_ENTRIES = ANT_PLANT_JOINTS * (ANT_PLANT_JOINTS + 1) / 2, /* of the stiffness's upper triangle */
    ANT_PLANT_P = 2 * ANT_PLANT_JOINTS,          /* place of the pressures in the state */
    ANT_PLANT_X = ANT_PLANT_P + ANT_PLANT_MUSCLES /* of the memory of friction */
};

typedef struct {
    double full[ANT_PLANT_STATES]; /* angles [rad], rates [rad/s], pressures [Pa], the memory of friction */
    double waiting[ANT_PLANT_QUEUE][ANT_PLANT_MUSCLES]; /* commands on their way, oldest first [Pa] */
} ant_plant;

typedef struct {
    double theta[ANT_PLANT_JOINTS]; /* as encoders read them [rad] */
    double K[ANT_PLANT_ENTRIES];    /* stiffness [N*m/rad]: K11, K12, ..., K22, ... */
    double T[ANT_PLANT_JOINTS];     /* torques of the muscles [N*m] */
    double F[ANT_PLANT_MUSCLES];    /* forces of the muscles [N] */
} ant_plant_outputs;

/* Begin in the state of angles [rad], rates [rad/s] and pressures [Pa], with these pressures commanded. */
void ant_plant_begin(ant_plant *p, const double x[ANT_PLANT_X]);

/* Go on by ANT_PLANT_DT, with the commands u [Pa] given now and torques d [N*m] from outside. */
void ant_plant_advance(ant_plant *p, const double u[ANT_PLANT_MUSCLES], const double d[ANT_PLANT_JOINTS]);

ant_plant_outputs ant_plant_look(const ant_plant *p);

#endif /* ANT_PLANT_H */
