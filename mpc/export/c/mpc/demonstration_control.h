/* Demonstration of control in main.c: the exported controller with its own model as the joint. */
#ifndef ANT_DEMONSTRATION_CONTROL_H
#define ANT_DEMONSTRATION_CONTROL_H

#include <stdio.h>
#include <string.h>

#include "control.h"
#include "model.h"
#include "tuning_file.h"

enum { ANT_SAMPLES = 100, ANT_SHOWN = 10 };

/* Half a turn of a cosine from the middle of the joint range and back, at constant stiffness. */
static void refer(ant_reference *r, int sample) {
    for (int k = 0; k <= ANT_AHEAD; k++) {
        const int at = sample + k < ANT_SAMPLES ? sample + k : ANT_SAMPLES;
        const ant_real swing = (1 - ANT_F(cos)(2 * ANT_PI * (ant_real)at / ANT_SAMPLES)) / 2;
        r->theta[k] = ANT_DEMO_MIDDLE + ANT_DEMO_SWING * swing;
        r->K[k] = ANT_DEMO_K;
    }
}

/* A sample of the joint under commands that act after the dead time. */
static void turn(ant_real x[4], ant_real waiting[ANT_DELAY + 1][2], const ant_real u[2]) {
    ant_real later[4], acting[2];
    const ant_real none = 0;
    memcpy(waiting[ANT_DELAY], u, sizeof waiting[0]);
    for (int i = 0; i < 2; i++) acting[i] = ant_after_dead_band(waiting[0][i], x[2 + i]);
    ant_model_stage(x, acting, &none, later);
    for (int k = 0; k < ANT_DELAY; k++) memcpy(waiting[k], waiting[k + 1], sizeof waiting[k]);
    memcpy(x, later, sizeof later);
}

/* `name`: a file with a tuning, or NULL. */
static int demonstrate_control(const char *name) {
    static ant_controller controller;
    static ant_tuning tuning;
    static ant_reference reference;
    static ant_plan plan;
    ant_real x[4] = {ANT_DEMO_MIDDLE, 0, ANT_DEMO_P1, ANT_DEMO_P2}, waiting[ANT_DELAY + 1][2];
    ant_real angles[ANT_AGE + 1]; /* that are still to be read, oldest first */
    for (int k = 0; k <= ANT_DELAY; k++) memcpy(waiting[k], &x[2], sizeof waiting[k]);
    for (int k = 0; k <= ANT_AGE; k++) angles[k] = x[0];
    ant_reset(&controller);
    if (name != NULL && !(ant_read_tuning(name, &tuning) && ant_tune(&controller, &tuning))) {
        fprintf(stderr, "%s is no tuning for this build\n", name);
        return 1;
    }
    for (int sample = 0; sample < ANT_SAMPLES; sample++) {
        const ant_reading reading = {angles[0], x[2], x[3]};
        refer(&reference, sample);
        ant_step(&controller, &reading, &reference, &plan);
        if (sample % ANT_SHOWN == 0)
            printf("sample %3d, theta %7.4f rad of %7.4f: u1 %8.1f Pa, u2 %8.1f Pa, status %d, rung %d\n", sample,
                   (double)x[0], (double)reference.theta[0], (double)plan.u[0][0], (double)plan.u[0][1],
                   (int)plan.status, (int)plan.rung);
        turn(x, waiting, plan.u[0]);
        for (int k = 0; k <= ANT_AGE; k++) angles[k] = k < ANT_AGE ? angles[k + 1] : x[0];
    }
    return 0;
}

#endif /* ANT_DEMONSTRATION_CONTROL_H */
