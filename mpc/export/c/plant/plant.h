/* A plant for tests of controllers, as in `mpc.RealPlant`; in double precision with any controller. */
#ifndef ANT_PLANT_H
#define ANT_PLANT_H

#include "plant_numbers.h"

/* The commands on their way, and one more that has just been given. */
enum { ANT_PLANT_QUEUE = ANT_PLANT_WAITING + 1 };

typedef struct {
    double full[ANT_PLANT_STATES];      /* theta [rad], its rate [rad/s], P1, P2 [Pa], the memory of friction */
    double waiting[ANT_PLANT_QUEUE][2]; /* commands on their way, oldest first [Pa] */
} ant_plant;

typedef struct {
    double theta; /* as an encoder reads it [rad] */
    double K;     /* stiffness [N*m/rad] */
    double T;     /* torque of the muscles [N*m] */
    double F[2];  /* forces of the muscles [N] */
} ant_plant_outputs;

/* Begin in the state theta [rad], its rate [rad/s], P1, P2 [Pa], with its pressures commanded. */
void ant_plant_begin(ant_plant *p, const double x[4]);

/* Go on by ANT_PLANT_DT, with the commands u [Pa] given now and a torque d [N*m] from outside. */
void ant_plant_advance(ant_plant *p, const double u[2], double d);

ant_plant_outputs ant_plant_look(const ant_plant *p);

#endif /* ANT_PLANT_H */
