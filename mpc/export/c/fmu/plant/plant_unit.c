/* A plant as an FMU: commands in, motion out. */
#include <math.h>

#include "plant.h"
#include "unit.h"

enum { /* positions of the first values, in the order of unit_variables.h */
    N = ANT_PLANT_JOINTS,
    M = ANT_PLANT_MUSCLES,
    U = 0,
    D = U + M,
    START = D + N,
    X = START + ANT_PLANT_X,
    MEASURED = X + ANT_PLANT_X,
    K = MEASURED + N,
    T = K + ANT_PLANT_ENTRIES,
    F = T + N
};

struct unit_memory {
    ant_plant plant;
};

size_t unit_memory_size(void) { return sizeof(unit_memory); }

static void put(double *to, const double *values, int count) {
    for (int i = 0; i < count; i++) to[i] = values[i];
}

static void show(const ant_plant *p, double *v) {
    const ant_plant_outputs y = ant_plant_look(p);
    put(v + X, p->full, ANT_PLANT_X);
    put(v + MEASURED, y.theta, N);
    put(v + K, y.K, ANT_PLANT_ENTRIES);
    put(v + T, y.T, N);
    put(v + F, y.F, M);
}

void unit_begin(unit_memory *memory, double *v) {
    ant_plant_begin(&memory->plant, v + START);
    show(&memory->plant, v);
}

int unit_advance(unit_memory *memory, double *v) {
    ant_plant_advance(&memory->plant, v + U, v + D);
    show(&memory->plant, v);
    int finite = 1;
    for (int k = K; k < F; k++) finite = finite && isfinite(v[k]);
    for (int k = 0; k < ANT_PLANT_STATES; k++) finite = finite && isfinite(memory->plant.full[k]);
    return finite;
}
