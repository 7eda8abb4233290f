/* A demonstration; README.md shows its expected output, computed in Python. */
#include <stdio.h>

#include "antagonist.h"
#include "demonstration.h"

#ifdef ANT_HORIZON
#include "demonstration_control.h"
#endif

static void show(const ant_real *numbers) {
    const ant_target target = ant_target_of(numbers[0], numbers[1], numbers[2]);
    const ant_allocation a = ant_allocate(&target);
    printf("theta %8.4f rad, K %7.4f N*m/rad, T %8.4f N*m: P1 %8.1f Pa, P2 %8.1f Pa, status %d, limits %d\n",
           (double)target.theta, (double)target.K, (double)target.T, (double)a.P1, (double)a.P2, (int)a.status,
           a.limits);
}

int main(int argc, char **argv) {
    for (int i = 0; i < ANT_DEMONSTRATIONS; i++) show(ANT_DEMONSTRATION[i]);
#ifdef ANT_HORIZON
    return demonstrate_control(argc > 1 ? argv[1] : NULL);
#else
    (void)argc, (void)argv;
    return 0;
#endif
}
