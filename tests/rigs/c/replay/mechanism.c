/* Targets of a mechanism from standard input, one a row: q, T, K, least and greatest force, pressures now, step, nearest,
 * follow, priority. Prints pressures, what they give, residual and status; with an argument, the time
 * of a target. */
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "antagonist.h"

enum { COLUMNS = 2 * ANT_JOINTS + ANT_STIFFNESSES + ANT_MUSCLES + 6, MOST = 20000 };
static double rows[MOST][COLUMNS];
static ant_memory memory;

static ant_target target_of(const double *row) {
    ant_real q[ANT_JOINTS], T[ANT_JOINTS];
    for (int i = 0; i < ANT_JOINTS; i++) q[i] = (ant_real)*row++;
    for (int i = 0; i < ANT_JOINTS; i++) T[i] = (ant_real)*row++;
    ant_target t = ant_target_of(q, T);
    for (int i = 0; i < ANT_STIFFNESSES; i++) t.K[i] = (ant_real)*row++;
    t.min_force = (ant_real)*row++;
    t.max_force = (ant_real)*row++;
    for (int i = 0; i < ANT_MUSCLES; i++) t.P_now[i] = (ant_real)*row++;
    t.max_step = (ant_real)*row++;
    t.nearest = (int)*row++;
    t.follow = (int)*row++;
    t.priority = (ant_priority)(int)*row++;
    return t;
}

static void timed(int count) {
    double least = 1e9;
    for (int round = 0; round < 20; round++) {
        ant_allocation a;
        const clock_t begin = clock();
        for (int i = 0; i < count; i++) {
            const ant_target t = target_of(rows[i]);
            ant_allocate(&t, &memory, &a);
        }
        const double each = (double)(clock() - begin) / CLOCKS_PER_SEC / count;
        if (each < least) least = each;
    }
    printf("%.4f\n", least * 1e6);
}

int main(int argc, char **argv) {
    (void)argv;
    int count = 0, read = 0;
    while (count < MOST && scanf("%lf", &rows[count][read]) == 1) {
        if (++read == COLUMNS) {
            count++;
            read = 0;
        }
    }
    if (argc > 1) {
        timed(count);
        return 0;
    }
    for (int i = 0; i < count; i++) {
        const ant_target t = target_of(rows[i]);
        ant_allocation a;
        ant_allocate(&t, &memory, &a);
        for (int k = 0; k < ANT_MUSCLES; k++) printf("%.17g ", (double)a.P[k]);
        for (int k = 0; k < ANT_JOINTS; k++) printf("%.17g ", (double)a.T[k]);
        for (int k = 0; k < ANT_STIFFNESSES; k++) printf("%.17g ", (double)a.K[k]);
        printf("%.17g %d", (double)a.residual, (int)a.status);
        printf("\n");
    }
    return 0;
}
