/* The formulas as the kernel calls them: they contain their numbers c. */
#ifndef ANT_FORMULAS_H
#define ANT_FORMULAS_H

#include "model.h"

static void motion(const ant_real *q, const ant_real *omega, const ant_real *P, const ant_real *scene,
                   const ant_real *c, ant_real *alpha, ant_real *gain, ant_real *force, ant_real *speed,
                   ant_real *squeeze, ant_real *energy) {
    (void)c;
    ant_model_motion(q, omega, P, scene, alpha, gain, force, speed, squeeze, energy);
}

static void potential(const ant_real *q, const ant_real *scene, const ant_real *c, ant_real *level) {
    (void)c;
    ant_model_potential(q, scene, level);
}

#endif /* ANT_FORMULAS_H */
