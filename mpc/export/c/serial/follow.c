/* References in, plans out. The last reference holds until another arrives. */
#include "follow.h"

#include <math.h>
#include <string.h>

#include "frames.h"
#include "port.h"

void ant_follower_begin(ant_follower *f) {
    memset(f, 0, sizeof *f);
    ant_reset(&f->controller);
}

int ant_follower_take(ant_follower *f, uint32_t first, const uint8_t *samples, uint32_t n) {
    if (first > f->have || first + n < first) return ANT_REFUSAL_GAP;
    if (first + n > f->sample + ANT_ROOM) return ANT_REFUSAL_GAP;
    for (uint32_t i = 0; i < n; i++) {
        const uint8_t *at = samples + i * ANT_SAMPLE_BYTES;
        const float K = ant_get_f32(at + ANT_SAMPLE_K);
        if (!isfinite(ant_get_f32(at + ANT_SAMPLE_THETA)) || !isfinite(K) || !(K > 0)) return ANT_REFUSAL_VALUE;
    }
    for (uint32_t i = f->have - first; i < n; i++) {
        const uint8_t *at = samples + i * ANT_SAMPLE_BYTES;
        f->theta[f->have % ANT_ROOM] = ant_get_f32(at + ANT_SAMPLE_THETA);
        f->K[f->have % ANT_ROOM] = ant_get_f32(at + ANT_SAMPLE_K);
        f->have++;
    }
    return 0;
}

static void look_ahead(ant_follower *f) {
    for (uint32_t k = 0; k <= ANT_AHEAD; k++) {
        const uint32_t wanted = f->sample + k, at = (wanted < f->have ? wanted : f->have - 1) % ANT_ROOM;
        f->window.theta[k][0] = (ant_real)f->theta[at];
        f->window.K[k][0] = (ant_real)f->K[at];
    }
}

int ant_follower_step(ant_follower *f) {
    const uint32_t now = clock_us();
    if (!f->running) {
        if (f->have <= ANT_AHEAD) return 0;
        f->running = 1;
        f->due = now;
    } else if ((int32_t)(now - f->due) < 0) {
        return 0;
    } else if (f->sample + 1 < f->have) {
        f->sample++;
    }
    f->due += ANT_TICK_US;
    if ((int32_t)(now - f->due) >= 0) f->due = now + ANT_TICK_US; /* late by more than a sample: it is not caught up */
    const ant_sensors s = read_sensors();
    const ant_reading reading = {{(ant_real)s.theta}, {(ant_real)s.P1, (ant_real)s.P2}};
    look_ahead(f);
    ant_step(&f->controller, &reading, &f->window, &f->plan);
    return 1;
}
