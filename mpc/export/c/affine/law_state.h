/* Two muscles affine in the pressure, F = A P + B, at an angle. */
#ifndef ANT_LAW_STATE_H
#define ANT_LAW_STATE_H

#include "antagonist.h"

/* One muscle, in this order by ant_model_sides. */
typedef struct {
    ant_real A;   /* force per pressure [N/Pa] */
    ant_real B;   /* force without pressure [N] */
    ant_real arm; /* moment arm [m] */
    ant_real k;   /* stiffness added per pressure [N*m/rad/Pa] */
    ant_real k0;  /* stiffness added without pressure [N*m/rad] */
} ant_side;

typedef struct {
    ant_side side[2];
} ant_law;

#endif /* ANT_LAW_STATE_H */
