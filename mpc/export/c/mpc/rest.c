/* Rest mode: the commands come to rest if the reference is constant. The pressures are held at the mean of the
 * hunting, both regulators on the same edge of their dead bands; the remaining angle error is corrected by a sampled
 * integral with a dead zone; a preview that changes, a sensor that is silent, or a push ends the rest. */
#include <string.h>

#include "control.h"
#include "model.h"

enum { QUARTERS = 4, HALF = 2 }; /* of the joint's free period */
enum { SWINGS = QUARTERS + HALF }; /* a load that throws the joint off is in QUARTERS of them */
enum { E, P1, P2, LOW, HIGH };   /* numbers of each: means, least and greatest e */

typedef struct {
    ant_real mean, low, high; /* of e [rad] */
} summary;

static void begin(ant_rest *r) {
    r->resting = r->samples = r->counted = r->swings = r->in_sum = 0;
    memset(r->sum, 0, sizeof r->sum);
}

/* Over the last quarters. */
static summary summed(const ant_rest *r, int quarters) {
    const ant_real(*last)[5] = &r->quarters[QUARTERS - quarters];
    ant_real sum = 0, low = last[0][LOW], high = last[0][HIGH];
    for (int k = 0; k < quarters; k++) {
        sum += last[k][E];
        if (last[k][LOW] < low) low = last[k][LOW];
        if (last[k][HIGH] > high) high = last[k][HIGH];
    }
    return (summary){sum / (ant_real)quarters, low, high};
}

static int constant(ant_rest *r, const ant_real *theta, const ant_real *K) {
    int same = r->known;
    for (int k = 0; same && k <= ANT_HORIZON; k++)
        same = ant_abs(theta[k] - r->reference[0]) <= ANT_REST_SAME_THETA &&
               ant_abs(K[k] - r->reference[1]) <= ANT_REST_SAME_K;
    if (same) return 1;
    r->known = 1;
    r->reference[0] = theta[0];
    r->reference[1] = K[0];
    const ant_real quarter = ANT_PI / 2 * ANT_F(sqrt)(ANT_INERTIA / K[0]) / ANT_DT;
    r->quarter = (int)(ant_clip(quarter, ANT_REST_QUARTER_LEAST, ANT_REST_QUARTER_MOST) + (ant_real)0.5);
    r->ringing = 0;
    return 0;
}

static int pushed(const ant_rest *r, const ant_real seen[4], ant_real expected) {
    if (!r->resting) return 0;
    const summary last = summed(r, QUARTERS);
    const ant_real away = ant_abs(seen[0] - r->reference[0] - last.mean);
    const ant_real least = ANT_REST_JOLT * (r->ringing ? 2 : 1); /* the prediction contains the missing friction */
    const ant_real unusual = ANT_REST_UNUSUAL * r->usual, jolt = unusual > least ? unusual : least;
    return ant_abs(seen[0] - expected) > jolt || away > ANT_REST_PUSH + last.high - last.low + r->free;
}

/* Follows how far the angle usually is from its prediction: steps of the encoder, errors of the model. */
static void watch(ant_rest *r, const ant_real seen[4], ant_real expected) {
    const ant_real off = ant_abs(seen[0] - expected);
    r->usual *= 1 - 1 / (ant_real)(QUARTERS * r->quarter);
    if (off > r->usual) r->usual = off;
}

static void rest(ant_rest *r) {
    const ant_real margin = ANT_DEAD_BAND / 2 + ANT_REST_LEAK;
    const int quarters = r->ringing ? QUARTERS : HALF;
    r->side = 1;
    for (int i = 0; i < 2; i++) {
        ant_real sum = 0;
        for (int k = QUARTERS - quarters; k < QUARTERS; k++) sum += r->quarters[k][P1 + i];
        r->p[i] = sum / (ant_real)quarters;
        if (!(r->p[i] + margin < ANT_SUPPLY_HI)) r->side = -1;
        r->began[i] = r->quarters[QUARTERS - 1][P1 + i];
    }
    r->resting = 1;
    r->since = 0;
    r->torque = r->error = 0;
    r->free = ANT_REST_EDGE;
}

static void check(ant_rest *r) {
    const summary all = summed(r, QUARTERS);
    const ant_real *last = r->quarters[QUARTERS - 1];
    const int rings = all.high > ANT_REST_RINGING && -all.low > ANT_REST_RINGING;
    r->swings = rings ? r->swings + (r->swings < SWINGS) : 0;
    if (r->swings == SWINGS) r->ringing = 1;
    if (!r->ringing && (last[HIGH] > ANT_REST_FAR || -last[LOW] > ANT_REST_FAR)) r->samples = 0;
    const ant_real grown = ANT_REST_START + ANT_REST_GROWTH * (ant_real)(r->samples - ANT_REST_DWELL);
    const ant_real bound = r->ringing ? ANT_REST_MEAN : grown < ANT_REST_FAR ? grown : ANT_REST_FAR;
    const int waited = r->ringing || r->samples >= ANT_REST_DWELL;
    if (waited && ant_abs(all.mean) <= bound && all.high - all.low <= ANT_REST_SWING) rest(r);
}

/* Whether a quarter of a period ends with this sample. */
static int quarter_ended(ant_rest *r, const ant_real seen[4]) {
    const ant_real e = seen[0] - r->reference[0];
    if (r->in_sum == 0 || e < r->low) r->low = e;
    if (r->in_sum == 0 || e > r->high) r->high = e;
    r->sum[E] += e;
    r->sum[P1] += seen[2];
    r->sum[P2] += seen[3];
    if (++r->in_sum < r->quarter) return 0;
    memmove(r->quarters[0], r->quarters[1], (QUARTERS - 1) * sizeof r->quarters[0]);
    ant_real *last = r->quarters[QUARTERS - 1];
    for (int i = E; i <= P2; i++) last[i] = r->sum[i] / (ant_real)r->in_sum;
    last[LOW] = r->low;
    last[HIGH] = r->high;
    if (r->counted < QUARTERS) r->counted++;
    memset(r->sum, 0, sizeof r->sum);
    r->in_sum = 0;
    return 1;
}

/* Gain [N*m/rad] of a joint that does not move: half the secant. */
static ant_real gain(const ant_rest *r, ant_real m, ant_real K) {
    ant_real g = ANT_REST_FIRST * K;
    if (r->torque != 0) {
        const ant_real moved = (m - r->error) * (r->torque > 0 ? 1 : -1);
        g = ant_clip(ant_abs(r->torque) / ((moved > 0 ? moved : 0) + ANT_REST_RESOLUTION) / 2, K, ANT_REST_STIFFEST * K);
    }
    const ant_real most = K * (1 + ANT_REST_OVERSHOOT / ant_abs(m));
    return g < most ? g : most;
}

/* Corrects the mean error m; the pressures have been P of late. */
static void turn(ant_rest *r, ant_real m, int swings, const ant_real P[2]) {
    const ant_real x[4] = {r->reference[0] + m, 0, r->p[0], r->p[1]};
    ant_real K, F[2], slope[2];
    ant_model_outputs(x, &K, F);
    ant_model_gains(x, slope);
    if (!(K > 0)) return;
    const ant_real torque = -m * (swings || r->ringing ? K : gain(r, m, K));
    for (int i = 0; i < 2; i++) {
        const ant_real change = r->side * torque / slope[i];
        if (!(change > 0)) continue;
        const ant_real held = r->side * r->p[i], there = r->side * P[i], began = r->side * r->began[i];
        const ant_real play = (there < began ? there : began) - ANT_REST_PRESSURE_NOISE;
        r->p[i] = r->side * ((held > play ? held : play) + (change < ANT_REST_MOST ? change : ANT_REST_MOST));
        r->began[i] = r->p[i];
    }
    r->since = 0;
    r->torque = torque;
    r->error = m;
    r->free = ant_abs(torque) / K;
}

static void correct(ant_rest *r) {
    ant_real P[2];
    for (int i = 0; i < 2; i++) {
        P[i] = (r->quarters[QUARTERS - 2][P1 + i] + r->quarters[QUARTERS - 1][P1 + i]) / 2;
        if (ant_abs(P[i] - r->p[i]) > ANT_DEAD_BAND / 2 + ANT_REST_LEAK) {
            begin(r);
            return;
        }
    }
    const summary half = summed(r, HALF);
    const int swings = half.high - half.low >= ANT_REST_STILL;
    const int waited = r->since - (ANT_REST_SETTLING + r->quarter - 1) / r->quarter;
    if (r->since < ANT_LONG) r->since++;
    if (waited > 0) r->free = 0;
    const ant_real m = summed(r, swings ? QUARTERS : 1).mean;
    const ant_real dead_zone = ANT_REST_DEAD_ZONE * (r->ringing ? 2 : 1); /* every correction makes it ring again */
    if (waited >= (swings ? QUARTERS - 1 : 0) && ant_abs(m) > dead_zone) turn(r, m, swings, P);
}

int ant_rest_follow(ant_rest *r, const ant_task *task) {
    const int known = task->measured && !task->refused;
    if (!(known && constant(r, task->theta, task->K)) || pushed(r, task->seen, task->expected)) {
        begin(r);
        return 0;
    }
    if (!r->resting) watch(r, task->seen, task->expected);
    if (r->samples < ANT_LONG) r->samples++;
    if (quarter_ended(r, task->seen)) {
        if (r->resting)
            correct(r);
        else if (r->counted == QUARTERS)
            check(r);
    }
    return r->resting;
}
