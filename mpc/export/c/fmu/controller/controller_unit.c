/* A controller and its observer as an FMU: readings and references in, commands out. */
#include "control.h"
#include "unit.h"

enum { /* positions of the first values, in the order of unit_variables.h */
    THETA = 0,
    P = ANT_JOINTS,
    THETA_REF = ANT_SENSORS,
    K_REF = THETA_REF + (ANT_AHEAD + 1) * ANT_JOINTS,
    U = K_REF + (ANT_AHEAD + 1) * ANT_STIFFNESSES,
    STATUS = U + ANT_MUSCLES,
    RUNG
};

struct unit_memory {
    ant_controller controller;
    ant_plan plan;
};

size_t unit_memory_size(void) { return sizeof(unit_memory); }

static void show(const ant_plan *plan, double *v) {
    for (int i = 0; i < ANT_MUSCLES; i++) v[U + i] = (double)plan->u[0][i];
    v[STATUS] = (double)plan->status;
    v[RUNG] = (double)plan->rung;
}

static void take(const double *v, ant_real *to, int count) {
    for (int i = 0; i < count; i++) to[i] = (ant_real)v[i];
}

/* Nothing was planned yet: the pressures that are measured are held. */
void unit_begin(unit_memory *memory, double *v) {
    ant_reset(&memory->controller);
    for (int i = 0; i < ANT_MUSCLES; i++) memory->plan.u[0][i] = ant_commandable((ant_real)v[P + i]);
    memory->plan.status = ANT_PLAN_OPTIMAL;
    memory->plan.rung = ANT_RUNG_HOLD;
    show(&memory->plan, v);
}

int unit_advance(unit_memory *memory, double *v) {
    ant_reading reading;
    ant_reference reference;
    take(v + THETA, reading.theta, ANT_JOINTS);
    take(v + P, reading.P, ANT_MUSCLES);
    take(v + THETA_REF, reference.theta[0], ANT_JOINTS * (ANT_AHEAD + 1));
    take(v + K_REF, reference.K[0], ANT_STIFFNESSES * (ANT_AHEAD + 1));
    ant_tune(&memory->controller, &ANT_TUNING); /* a state of another process contains its addresses */
    ant_step(&memory->controller, &reading, &reference, &memory->plan);
    show(&memory->plan, v);
    return 1; /* for any input: the controller's status reports problems */
}
