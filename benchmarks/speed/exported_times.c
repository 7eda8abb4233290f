/* Reads samples as tests/rigs/c/replay/control.c does, and writes how long each ant_step and its allocation took: on a PC
 * seconds, from repetitions on copies of the controller; on a Cortex-M4F instructions, of which QEMU counts one a
 * nanosecond (-icount shift=0), by the SysTick timer of 25 MHz. */
#include <stdio.h>

#include "../../tests/rigs/c/replay/samples.h"
#include "control.h"

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
static double in[ANT_SAMPLE];
static ant_sample sample;
static ant_plan plan;

static double time_of_step(void) {
    for (int i = 0; i < REPEATS; i++) copies[i] = controller;
    start();
    for (int i = 0; i < REPEATS; i++) ant_step(&copies[i], &sample.reading, &sample.reference, &plan);
    const double seconds = took() / REPEATS;
    controller = copies[0];
    return seconds;
}

static double time_of_allocation(void) {
    volatile ant_real sum = 0;
    static ant_memory memory;
    start();
    for (int i = 0; i < ALLOCATIONS; i++) {
        const ant_real T[ANT_JOINTS] = {(ant_real)0.01 * (ant_real)(i % 10)};
        ant_real P[ANT_MUSCLES], left[ANT_JOINTS], K[ANT_STIFFNESSES];
        ant_held(plan.x[1], sample.reference.K[0], T, 0, &memory, P, left, K);
        sum += P[0];
    }
    return took() / ALLOCATIONS;
}

int main(int argc, char **argv) {
    FILE *from = argc == 3 ? fopen(argv[1], "rb") : NULL, *to = argc == 3 ? fopen(argv[2], "wb") : NULL;
    if (from == NULL || to == NULL) return 1;
    ant_reset(&controller);
    while (fread(in, sizeof in, 1, from) == 1) {
        ant_sample_of(in, &sample);
        controller.exchange_limit = sample.fails ? 0 : ANT_EXCHANGES;
        const double step = time_of_step();
        const double out[3] = {step, time_of_allocation(), plan.exchanges};
        if (fwrite(out, sizeof out, 1, to) != 1) return 2;
    }
    return fclose(from) || fclose(to);
}
