/* Demonstration of control in main.c: the exported controller with its own model as the joint. */
#ifndef ANT_DEMONSTRATION_CONTROL_H
#define ANT_DEMONSTRATION_CONTROL_H

#include <stdio.h>
#include <string.h>

#include "control.h"
#include "model.h"
#include "tables.h"
#include "tuning_file.h"

enum { ANT_SAMPLES = 100, ANT_SHOWN = 10 };

/* Half a turn of a cosine from the middle of the joint ranges and back, at constant stiffness. */
static void refer(ant_reference *r, int sample) {
    for (int k = 0; k <= ANT_AHEAD; k++) {
        const int at = sample + k < ANT_SAMPLES ? sample + k : ANT_SAMPLES;
        const ant_real swing = (1 - ANT_F(cos)(2 * ANT_PI * (ant_real)at / ANT_SAMPLES)) / 2;
        for (int i = 0; i < ANT_JOINTS; i++) r->theta[k][i] = ANT_DEMO_MIDDLE[i] + ANT_DEMO_SWING[i] * swing;
        memcpy(r->K[k], ANT_DEMO_K, sizeof r->K[k]);
    }
}

/* A sample of the machine under commands that act after the dead time. */
static void turn(ant_real x[ANT_STATES], ant_real waiting[ANT_DELAY + 1][ANT_MUSCLES], const ant_real u[ANT_MUSCLES]) {
    static const ant_real none[ANT_JOINTS];
    ant_real later[ANT_STATES], acting[ANT_MUSCLES];
    memcpy(waiting[ANT_DELAY], u, sizeof waiting[0]);
    for (int i = 0; i < ANT_MUSCLES; i++) acting[i] = ant_after_dead_band(waiting[0][i], x[2 * ANT_JOINTS + i]);
    ant_model_stage(x, acting, none, later);
    for (int k = 0; k < ANT_DELAY; k++) memcpy(waiting[k], waiting[k + 1], sizeof waiting[k]);
    memcpy(x, later, sizeof later);
}

static void show_row(const char *name, const char *format, const ant_real *row, int count) {
    printf("%s", name);
    for (int i = 0; i < count; i++) printf(format, (double)row[i]);
}

/* `name`: a file with a tuning, or NULL. */
static int demonstrate_control(const char *name) {
    static ant_controller controller;
    static ant_tuning tuning;
    static ant_reference reference;
    static ant_plan plan;
    ant_real x[ANT_STATES] = {0}, waiting[ANT_DELAY + 1][ANT_MUSCLES];
    ant_reading held[ANT_AGE + 1]; /* angles that are still to be read, oldest first */
    memcpy(x, ANT_DEMO_MIDDLE, sizeof held[0].theta);
    memcpy(x + 2 * ANT_JOINTS, ANT_DEMO_P, sizeof waiting[0]);
    for (int k = 0; k <= ANT_DELAY; k++) memcpy(waiting[k], ANT_DEMO_P, sizeof waiting[k]);
    for (int k = 0; k <= ANT_AGE; k++) memcpy(held[k].theta, x, sizeof held[k].theta);
    ant_reset(&controller);
    if (name != NULL && !(ant_read_tuning(name, &tuning) && ant_tune(&controller, &tuning))) {
        fprintf(stderr, "%s is no tuning for this build\n", name);
        return 1;
    }
    for (int sample = 0; sample < ANT_SAMPLES; sample++) {
        ant_reading reading = held[0];
        memcpy(reading.P, x + 2 * ANT_JOINTS, sizeof reading.P);
        refer(&reference, sample);
        ant_step(&controller, &reading, &reference, &plan);
        if (sample % ANT_SHOWN == 0) {
            printf("sample %3d", sample);
            show_row(", theta", " %7.4f", x, ANT_JOINTS);
            show_row(" rad of", " %7.4f", reference.theta[0], ANT_JOINTS);
            show_row(": u", " %8.1f", plan.u[0], ANT_MUSCLES);
            printf(" Pa, status %d, rung %d\n", (int)plan.status, (int)plan.rung);
        }
        turn(x, waiting, plan.u[0]);
        for (int k = 0; k < ANT_AGE; k++) held[k] = held[k + 1];
        memcpy(held[ANT_AGE].theta, x, sizeof held[0].theta);
    }
    return 0;
}

#endif /* ANT_DEMONSTRATION_CONTROL_H */
