/* A demonstration; README.md shows its expected output, computed in Python. */
#include <stdio.h>

#include "antagonist.h"
#include "demonstration.h"

#ifdef ANT_HORIZON
#include "demonstration_control.h"
#endif

static ant_memory memory;

static void show(const char *name, const ant_real *numbers, int count) {
    printf("%s", name);
    for (int i = 0; i < count; i++) printf(" %.6g", (double)numbers[i]);
}

static void allocate(const ant_real *row) {
    ant_target target = ant_target_of(row, row + ANT_JOINTS);
    for (int k = 0; k < ANT_STIFFNESSES; k++) target.K[k] = row[2 * ANT_JOINTS + k];
    ant_allocation a;
    ant_allocate(&target, &memory, &a);
    show("T", target.T, ANT_JOINTS);
    show(" N*m, K", target.K, ANT_STIFFNESSES);
    show(" N*m/rad: P", a.P, ANT_MUSCLES);
    printf(" Pa, status %d\n", (int)a.status);
}

int main(int argc, char **argv) {
    const int count = ANT_DEMONSTRATIONS;
    for (int i = 0; i < count; i++) allocate(ANT_DEMONSTRATION[i]);
#ifdef ANT_HORIZON
    return demonstrate_control(argc > 1 ? argv[1] : NULL);
#else
    (void)argc, (void)argv;
    return 0;
#endif
}
