/* Samples of tests/rigs/replay.py: readings, whether the QP solver is to fail, and the reference. */
#include "antagonist.h"

enum { ANT_SAMPLE = ANT_SENSORS + 1 + (ANT_AHEAD + 1) * (ANT_JOINTS + ANT_STIFFNESSES) };

typedef struct {
    ant_reading reading;
    int fails;
    ant_reference reference;
} ant_sample;

static const double *ant_take(const double *from, ant_real *to, int count) {
    for (int i = 0; i < count; i++) to[i] = (ant_real)from[i];
    return from + count;
}

static void ant_sample_of(const double in[ANT_SAMPLE], ant_sample *s) {
    const double *rest = ant_take(ant_take(in, s->reading.theta, ANT_JOINTS), s->reading.P, ANT_MUSCLES);
    s->fails = *rest++ > 0;
    rest = ant_take(rest, s->reference.theta[0], ANT_JOINTS * (ANT_AHEAD + 1));
    ant_take(rest, s->reference.K[0], ANT_STIFFNESSES * (ANT_AHEAD + 1));
}
