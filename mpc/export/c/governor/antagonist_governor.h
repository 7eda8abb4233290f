/* The one function of the governor. */
#ifndef ANTAGONIST_GOVERNOR_H
#define ANTAGONIST_GOVERNOR_H

#include "antagonist_memory.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Fill `safe` with the pressures [Pa] to command instead of `command`; return the result.
 *
 * q [rad], omega [rad/s], P [Pa]: the joints' angles and rates and the pressures now; previous [Pa]: the last
 * commands. If any of these is not finite, the answer is `previous` within the supply and ANT_GOVERNED_BAD_INPUT. */
int ant_govern(const ant_real q[ANT_JOINTS], const ant_real omega[ANT_JOINTS], const ant_real P[ANT_MUSCLES],
               const ant_real previous[ANT_MUSCLES], const ant_real command[ANT_MUSCLES], ant_real safe[ANT_MUSCLES],
               ant_memory *memory);

#ifdef __cplusplus
}
#endif

#endif /* ANTAGONIST_GOVERNOR_H */
