/* Innovation gating within physical bounds. A reading is rejected if it is farther from the expected one than
 * ANT_SIGMAS standard deviations and the steps of an encoder. From the first rejection on the width grows at a fixed
 * rate, not with the variance of an estimate without the sensor. */
#include "control.h"
#include "tables.h"

static void forget(ant_gate *g, ant_real refused) {
    g->width = 0;
    g->since = 0;
    g->refused = refused;
}

void ant_gate_reset(ant_gate *g) { forget(g, ANT_NAN); }

void ant_gate_frozen(ant_gate *g, ant_real read) { forget(g, read); }

ant_real ant_unwrapped(ant_real theta, ant_real expected, ant_real within) {
    const ant_real turn = 2 * ANT_PI;
    if (!(ant_abs(theta) < ANT_MOST_TURNS * turn)) return theta;
    const ant_real near = theta + turn * ANT_F(floor)((expected - theta) / turn + ANT_R(0.5));
    return ant_abs(near - expected) < within ? near : theta;
}

ant_verdict ant_first_verdict(int sensor, ant_real read) {
    if (!isfinite(read)) return ANT_SILENT;
    return ANT_GATE_LOWER[sensor] <= read && read <= ANT_GATE_UPPER[sensor] ? ANT_BELIEVED : ANT_IMPOSSIBLE;
}

ant_real ant_gate_width(const ant_gate *g, ant_real variance) {
    const ant_real width = ANT_SIGMAS * ANT_F(sqrt)(variance);
    return width > g->floor ? width : g->floor;
}

ant_verdict ant_check_reading(ant_gate *g, int sensor, ant_real read, ant_real least, ant_real most, ant_real variance) {
    const ant_verdict first = ant_first_verdict(sensor, read);
    if (g->since > 0 && g->since < ANT_LONG) g->since++;
    if (first != ANT_BELIEVED) return first;
    ant_real width = g->width * (1 + (ant_real)(g->since - 1) * ANT_GATE_GROWTH);
    if (g->since == 0) width = ant_gate_width(g, variance);
    const int repeated = ant_equal(read, g->refused); /* and expected only because two motions cross */
    if (ant_abs(read - ant_clip(read, least, most)) <= width && !repeated) {
        ant_gate_reset(g);
        return ANT_BELIEVED;
    }
    if (g->since == 0 && !repeated && ant_abs(read - g->refused) <= ANT_GATE_JUMP[sensor]) {
        ant_gate_reset(g); /* it was at rest, not frozen */
        return ANT_ACCEPTED;
    }
    if (g->since == 0) {
        g->width = width;
        g->since = 1;
    }
    g->refused = read;
    return ANT_REJECTED;
}
