/* One command: the state is checked, and the kernel does the rest. */
#include "antagonist_governor.h"
#include "governor.h"

static int finite(const ant_real *values, int count) {
    for (int i = 0; i < count; i++) {
        if (!isfinite(values[i])) return 0;
    }
    return 1;
}

int ant_govern(const ant_real q[ANT_JOINTS], const ant_real omega[ANT_JOINTS], const ant_real P[ANT_MUSCLES],
               const ant_real previous[ANT_MUSCLES], const ant_real command[ANT_MUSCLES], ant_real safe[ANT_MUSCLES],
               ant_memory *memory) {
    if (finite(q, ANT_JOINTS) && finite(omega, ANT_JOINTS) && finite(P, ANT_MUSCLES) && finite(previous, ANT_MUSCLES)) {
        return ant_kernel_govern(&ANT_RULES, q, omega, P, previous, command, safe, memory);
    }
    for (int j = 0; j < ANT_MUSCLES; j++) safe[j] = ant_clip(previous[j], ANT_SUPPLY_LO, ANT_RULES_MOST[j]);
    return ANT_GOVERNED_BAD_INPUT;
}
