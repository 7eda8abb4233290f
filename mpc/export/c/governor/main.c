/* A demonstration; README.md shows its expected output, computed in Python. */
#include <stdio.h>

#include "antagonist_governor.h"
#include "demonstration.h"

static ant_memory memory;

int main(void) {
    for (int i = 0; i < ANT_DEMONSTRATIONS; i++) {
        const ant_real *q = ANT_DEMONSTRATION[i], *omega = q + ANT_JOINTS, *P = omega + ANT_JOINTS;
        const ant_real *previous = P + ANT_MUSCLES, *command = previous + ANT_MUSCLES;
        ant_real safe[ANT_MUSCLES];
        const int status = ant_govern(q, omega, P, previous, command, safe, &memory);
        printf("status %d, P", status);
        for (int j = 0; j < ANT_MUSCLES; j++) printf(" %.6g", (double)safe[j]);
        printf(" Pa\n");
    }
    return 0;
}
