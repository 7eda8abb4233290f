/* Reads samples as tests/rigs/c/replay/control.c does, and writes how long each ant_step and its allocation took: on a PC
 * seconds, from repetitions on copies of the controller; on a Cortex-M4F instructions, of which QEMU counts one a
 * nanosecond (-icount shift=0), by the SysTick timer of 25 MHz. */
#include <stdio.h>

#include "antagonist.h"

#ifdef __arm__
#include <stdint.h>
enum { REPEATS = 1, ALLOCATIONS = 16 };
static volatile uint32_t *const SYSTICK = (volatile uint32_t *)0xE000E010u; /* control, reload, value */
static uint32_t began;
static void start(void) {
    SYSTICK[1] = 0xFFFFFF;
    SYSTICK[2] = 0;
    SYSTICK[0] = 5;
    began = SYSTICK[2];
}
static double took(void) { return ((began - SYSTICK[2]) & 0xFFFFFF) * 40.0; }
#else
#include <time.h>
enum { REPEATS = 20, ALLOCATIONS = 2000 };
static clock_t began;
static void start(void) { began = clock(); }
static double took(void) { return (double)(clock() - began) / CLOCKS_PER_SEC; }
#endif

static ant_controller controller, copies[REPEATS];
static double in[4 + 2 * (ANT_AHEAD + 1)];
static ant_reference reference;
static ant_plan plan;

static double time_of_step(const ant_reading *reading) {
    for (int i = 0; i < REPEATS; i++) copies[i] = controller;
    start();
    for (int i = 0; i < REPEATS; i++) ant_step(&copies[i], reading, &reference, &plan);
    const double seconds = took() / REPEATS;
    controller = copies[0];
    return seconds;
}

static double time_of_allocation(void) {
    volatile ant_real sum = 0;
    start();
    for (int i = 0; i < ALLOCATIONS; i++) {
        const ant_target target = ant_target_of(plan.x[1][0], reference.K[0], (ant_real)0.01 * (ant_real)(i % 10));
        sum += ant_allocate(&target).P1;
    }
    return took() / ALLOCATIONS;
}

int main(int argc, char **argv) {
    FILE *from = argc == 3 ? fopen(argv[1], "rb") : NULL, *to = argc == 3 ? fopen(argv[2], "wb") : NULL;
    if (from == NULL || to == NULL) return 1;
    ant_reset(&controller);
    while (fread(in, sizeof in, 1, from) == 1) {
        const ant_reading reading = {(ant_real)in[0], (ant_real)in[1], (ant_real)in[2]};
        for (int k = 0; k <= ANT_AHEAD; k++) {
            reference.theta[k] = (ant_real)in[4 + k];
            reference.K[k] = (ant_real)in[4 + ANT_AHEAD + 1 + k];
        }
        controller.exchange_limit = in[3] != 0 ? 0 : ANT_EXCHANGES;
        const double step = time_of_step(&reading);
        const double out[3] = {step, time_of_allocation(), plan.exchanges};
        if (fwrite(out, sizeof out, 1, to) != 1) return 2;
    }
    return fclose(from) || fclose(to);
}
