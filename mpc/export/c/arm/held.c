/* Pressures of an arm's muscles for stiffness and torques, by the allocation of its mechanism. */
#include <string.h>

#include "control.h"

int ant_held(const ant_real q[ANT_JOINTS], const ant_real K[ANT_STIFFNESSES], const ant_real T[ANT_JOINTS],
             ant_real min_force, ant_memory *memory, ant_real P[ANT_MUSCLES], ant_real left[ANT_JOINTS],
             ant_real given[ANT_STIFFNESSES]) {
    ant_target target = ant_target_of(q, T);
    ant_allocation held;
    memcpy(target.K, K, sizeof target.K);
    target.min_force = min_force;
    target.follow = 1;
    ant_allocate(&target, memory, &held);
    memcpy(P, held.P, sizeof held.P);
    memcpy(given, held.K, sizeof held.K);
    for (int i = 0; i < ANT_JOINTS; i++) left[i] = T[i] - held.T[i];
    return held.status != ANT_BAD_INPUT;
}
