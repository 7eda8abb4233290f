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

/* Whether the stiffness with this upper triangle is positive definite (Cholesky), as one that holds the joints. */
static int holds(const float K[ANT_STIFFNESSES]) {
    float R[ANT_JOINTS][ANT_JOINTS];
    for (int i = 0; i < ANT_JOINTS; i++)
        for (int j = i; j < ANT_JOINTS; j++) {
            float rest = *K++;
            for (int k = 0; k < i; k++) rest -= R[k][i] * R[k][j];
            if (j == i && !(rest > 0 && isfinite(rest))) return 0;
            R[i][j] = j == i ? sqrtf(rest) : rest / R[i][i];
        }
    return 1;
}

static int acceptable(const uint8_t *sample) {
    float theta[ANT_JOINTS], K[ANT_STIFFNESSES];
    ant_get_row(sample + ANT_SAMPLE_THETA, theta, ANT_JOINTS);
    ant_get_row(sample + ANT_SAMPLE_K, K, ANT_STIFFNESSES);
    for (int i = 0; i < ANT_JOINTS; i++)
        if (!isfinite(theta[i])) return 0;
    return holds(K);
}

int ant_follower_take(ant_follower *f, uint32_t first, const uint8_t *samples, uint32_t n) {
    if (first > f->have || first + n < first) return ANT_REFUSAL_GAP;
    if (first + n > f->sample + ANT_ROOM) return ANT_REFUSAL_GAP;
    for (uint32_t i = 0; i < n; i++)
        if (!acceptable(samples + i * ANT_SAMPLE_BYTES)) return ANT_REFUSAL_VALUE;
    for (uint32_t i = f->have - first; i < n; i++) {
        const uint8_t *at = samples + i * ANT_SAMPLE_BYTES;
        ant_get_row(at + ANT_SAMPLE_THETA, f->theta[f->have % ANT_ROOM], ANT_JOINTS);
        ant_get_row(at + ANT_SAMPLE_K, f->K[f->have % ANT_ROOM], ANT_STIFFNESSES);
        f->have++;
    }
    return 0;
}

static void look_ahead(ant_follower *f) {
    for (uint32_t k = 0; k <= ANT_AHEAD; k++) {
        const uint32_t wanted = f->sample + k, at = (wanted < f->have ? wanted : f->have - 1) % ANT_ROOM;
        for (int i = 0; i < ANT_JOINTS; i++) f->window.theta[k][i] = (ant_real)f->theta[at][i];
        for (int i = 0; i < ANT_STIFFNESSES; i++) f->window.K[k][i] = (ant_real)f->K[at][i];
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
    ant_reading reading;
    for (int i = 0; i < ANT_JOINTS; i++) reading.theta[i] = (ant_real)s.theta[i];
    for (int i = 0; i < ANT_MUSCLES; i++) reading.P[i] = (ant_real)s.P[i];
    look_ahead(f);
    ant_step(&f->controller, &reading, &f->window, &f->plan);
    return 1;
}
