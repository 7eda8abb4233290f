/* A program with nothing but the controller, to see its size. */
#include "antagonist.h"

static ant_controller controller;
static ant_reference reference;
static ant_plan plan;
static volatile ant_reading sensors;
static volatile ant_real valves[ANT_MUSCLES];

int main(void) {
    ant_reset(&controller);
    for (;;) {
        const ant_reading reading = sensors;
        ant_step(&controller, &reading, &reference, &plan);
        for (int i = 0; i < ANT_MUSCLES; i++) valves[i] = plan.u[0][i];
    }
}
