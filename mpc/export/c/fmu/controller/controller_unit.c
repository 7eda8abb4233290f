/* A controller and its observer as an FMU: readings and references in, commands out. */
#include "control.h"
#include "unit.h"

struct unit_memory {
    ant_controller controller;
    ant_plan plan;
};

size_t unit_memory_size(void) { return sizeof(unit_memory); }

static void show(const ant_plan *plan, double *v) {
    v[UNIT_U1] = (double)plan->u[0][0];
    v[UNIT_U2] = (double)plan->u[0][1];
    v[UNIT_STATUS] = (double)plan->status;
    v[UNIT_RUNG] = (double)plan->rung;
}

/* Nothing was planned yet: the pressures that are measured are held. */
void unit_begin(unit_memory *memory, double *v) {
    ant_reset(&memory->controller);
    memory->plan.u[0][0] = ant_commandable((ant_real)v[UNIT_P1]);
    memory->plan.u[0][1] = ant_commandable((ant_real)v[UNIT_P2]);
    memory->plan.status = ANT_PLAN_OPTIMAL;
    memory->plan.rung = ANT_RUNG_HOLD;
    show(&memory->plan, v);
}

int unit_advance(unit_memory *memory, double *v) {
    const ant_reading reading = {(ant_real)v[UNIT_THETA], (ant_real)v[UNIT_P1], (ant_real)v[UNIT_P2]};
    ant_reference reference;
    for (int k = 0; k <= ANT_AHEAD; k++) {
        reference.theta[k] = (ant_real)v[UNIT_THETA_REF + k];
        reference.K[k] = (ant_real)v[UNIT_K_REF + k];
    }
    ant_tune(&memory->controller, &ANT_TUNING); /* a state of another process contains its addresses */
    ant_step(&memory->controller, &reading, &reference, &memory->plan);
    show(&memory->plan, v);
    return 1; /* for any input: the controller's status reports problems */
}
