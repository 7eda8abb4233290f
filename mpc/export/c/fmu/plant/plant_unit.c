/* A plant as an FMU: commands in, motion out. */
#include <math.h>

#include "plant.h"
#include "unit.h"

struct unit_memory {
    ant_plant plant;
};

size_t unit_memory_size(void) { return sizeof(unit_memory); }

static void show(const ant_plant *p, double *v) {
    const ant_plant_outputs y = ant_plant_look(p);
    v[UNIT_THETA] = p->full[0];
    v[UNIT_OMEGA] = p->full[1];
    v[UNIT_P1] = p->full[2];
    v[UNIT_P2] = p->full[3];
    v[UNIT_THETA_MEASURED] = y.theta;
    v[UNIT_K] = y.K;
    v[UNIT_T] = y.T;
    v[UNIT_F1] = y.F[0];
    v[UNIT_F2] = y.F[1];
}

void unit_begin(unit_memory *memory, double *v) {
    const double x[4] = {v[UNIT_THETA_START], v[UNIT_OMEGA_START], v[UNIT_P1_START], v[UNIT_P2_START]};
    ant_plant_begin(&memory->plant, x);
    show(&memory->plant, v);
}

int unit_advance(unit_memory *memory, double *v) {
    const double u[2] = {v[UNIT_U1], v[UNIT_U2]};
    ant_plant_advance(&memory->plant, u, v[UNIT_D]);
    show(&memory->plant, v);
    int finite = isfinite(v[UNIT_K]) && isfinite(v[UNIT_T]);
    for (int k = 0; k < ANT_PLANT_STATES; k++) finite = finite && isfinite(memory->plant.full[k]);
    return finite;
}
