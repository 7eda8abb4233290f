/* What the allocation asks of the muscles at an angle; muscles are counted 0 (agonist) and 1 (antagonist). */
#ifndef ANT_LAW_H
#define ANT_LAW_H

#include "antagonist.h"
#include "box.h"
#include "joint.h"
#include "law_state.h"

ant_law ant_law_at(ant_real theta);                                        /* the joint at an angle [rad] */
ant_real ant_law_arm(const ant_law *law, int muscle);                      /* moment arm [m] */
ant_real ant_law_force(const ant_law *law, int muscle, ant_real P);        /* [N]; negative: slack */
ant_real ant_law_stiffness(const ant_law *law, int muscle, ant_real P);    /* what it adds to K [N*m/rad] */
ant_real ant_law_pressure(const ant_law *law, int muscle, ant_real force); /* [Pa]; INFINITY: none */
int ant_law_holds(const ant_law *law, const ant_box *box);                 /* whether what follows is proved there */

/* The pressures of the box with the torque (stiffness) nearest to T (K), and of them those nearest to the other. */
ant_pair ant_law_torque_first(const ant_law *law, const ant_box *box, ant_real T, ant_real K);
ant_pair ant_law_stiffness_first(const ant_law *law, const ant_box *box, ant_real T, ant_real K);

#endif /* ANT_LAW_H */
