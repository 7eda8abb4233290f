/* Pressures of a joint's two muscles for stiffness and torque, by the closed-form allocation. */
#include "control.h"

int ant_positive_definite(const ant_real *K) { return K[0] > 0; }

int ant_held(const ant_real q[ANT_JOINTS], const ant_real K[ANT_STIFFNESSES], const ant_real T[ANT_JOINTS],
             ant_real min_force, ant_memory *memory, ant_real P[ANT_MUSCLES], ant_real left[ANT_JOINTS],
             ant_real given[ANT_STIFFNESSES]) {
    (void)memory;
    ant_target target = ant_target_of(q[0], K[0], T[0]);
    target.min_force = min_force;
    const ant_allocation held = ant_allocate(&target);
    P[0] = held.P1, P[1] = held.P2;
    left[0] = T[0] - held.T;
    given[0] = held.K;
    return held.status >= 0;
}
