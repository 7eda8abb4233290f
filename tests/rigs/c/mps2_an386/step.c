/* A program with nothing but the controller, to see its size. */
#include "antagonist.h"

static ant_controller controller;
static ant_reference reference;
static ant_plan plan;
static volatile ant_reading sensors;
static volatile ant_real valves[2];

int main(void) {
    ant_reset(&controller);
    for (;;) {
        const ant_reading reading = sensors;
        ant_step(&controller, &reading, &reference, &plan);
        valves[0] = plan.u[0][0];
        valves[1] = plan.u[0][1];
    }
}
