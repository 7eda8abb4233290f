/* State and disturbance torque from readings: the filter of filter.c behind the gates of gating.c.
 *
 * A sensor may be silent, frozen or rejected for ANT_TOLERANCE seconds; after that its quantity is NaN until a reading
 * is accepted again. A sensor that repeats itself may be frozen or at rest: an estimate without it decides. While
 * readings are rejected, a rival estimate uses them; once it has explained them for long enough, it takes over. */
#include <string.h>

#include "control.h"
#include "tables.h"

static void believed(const ant_observer *o, int used[ANT_SENSORS]) {
    for (int i = 0; i < ANT_SENSORS; i++) used[i] = o->verdicts[i] <= ANT_ACCEPTED;
}

static int can_be_sent(int muscle, ant_real u) { return ant_first_verdict(ANT_JOINTS + muscle, u) == ANT_BELIEVED; }

static int all(const int there[ANT_JOINTS]) {
    for (int i = 0; i < ANT_JOINTS; i++)
        if (!there[i]) return 0;
    return 1;
}

/* The first angles that can be ones begin; a pressure that is not measured is the one that was sent. */
static void begin(ant_observer *o, const ant_real said[ANT_SENSORS], const ant_real sent[ANT_MUSCLES]) {
    ant_real read[ANT_SENSORS], xi[ANT_BELIEFS] = {0};
    int there[ANT_SENSORS], possible = 1;
    for (int i = 0; i < ANT_SENSORS; i++) {
        read[i] = said[i];
        if (i < ANT_JOINTS)
            read[i] = ant_unwrapped(said[i], (ANT_LEAST_ANGLE[i] + ANT_MOST_ANGLE[i]) / 2, ANT_PI);
        o->verdicts[i] = ant_first_verdict(i, read[i]);
        ant_gate_reset(&o->gates[i]);
        o->gates[i].floor = ANT_GATE_FLOOR[i];
        o->noise[i] = ANT_R_NOISE[i];
        xi[ant_measured(i)] = read[i];
    }
    believed(o, there);
    for (int i = 0; i < ANT_MUSCLES; i++) {
        ant_real *P = &xi[2 * ANT_JOINTS + i];
        if (!there[ANT_JOINTS + i]) *P = sent[i];
        possible = possible && can_be_sent(i, *P);
    }
    if (!all(there) || !possible) return;
    memcpy(o->belief.xi, xi, sizeof xi);
    memcpy(o->belief.covariance, ANT_COVARIANCE, sizeof o->belief.covariance);
    ant_correct(o, &o->belief, read, there);
    for (int k = 0; k <= ANT_DELAY + ANT_AGE; k++)
        for (int i = 0; i < ANT_MUSCLES; i++)
            o->commands[k][i] = can_be_sent(i, sent[i]) ? sent[i] : xi[2 * ANT_JOINTS + i];
    o->unrivalled = ANT_CROSSING;
    for (int i = 0; i < ANT_JOINTS; i++) o->step[i] = ANT_COARSEST;
    o->begun = 1;
}

static void remember(ant_observer *o, const ant_real sent[ANT_MUSCLES]) {
    const int newest = ANT_DELAY + ANT_AGE;
    for (int k = 0; k < newest; k++) memcpy(o->commands[k], o->commands[k + 1], sizeof o->commands[k]);
    for (int i = 0; i < ANT_MUSCLES; i++)
        if (can_be_sent(i, sent[i])) o->commands[newest][i] = sent[i];
}

/* Whether a reading is too far from the value predicted without it. */
static int doubtful(const ant_observer *o, const ant_belief *predicted, int sensor, ant_real read) {
    const ant_real error = read - ant_foreseen(predicted, sensor);
    return error * error > ANT_DOUBT * ANT_DOUBT * ant_innovation_variance(o, predicted, sensor);
}

/* Updates the estimate without a sensor that repeats itself; if it contradicts the sensor for long, that is frozen. */
static void suspect(ant_observer *o, int i, const ant_belief *previous, ant_belief *expected,
                    const ant_real read[ANT_SENSORS], const int others[ANT_SENSORS]) {
    if (!o->repeats[i]) o->without[i] = *previous;
    o->repeats[i] = 1;
    ant_predict_belief(o, &o->without[i], 0, ANT_Q_REST[i]);
    if (!o->frozen[i] && o->repeating[i] > ANT_TOLERANCE && doubtful(o, &o->without[i], i, read[i])) {
        o->frozen[i] = 1;
        *expected = o->without[i];
    }
    if (o->frozen[i]) {
        ant_gate_frozen(&o->gates[i], read[i]);
        o->verdicts[i] = ANT_FROZEN;
    }
    ant_correct(o, &o->without[i], read, others);
}

/* Predicts the readings without the frozen sensors, and marks these. */
static void without_frozen(ant_observer *o, const ant_belief *previous, ant_belief *expected, const ant_real said[ANT_SENSORS],
                           const ant_real read[ANT_SENSORS]) {
    int others[ANT_SENSORS], repeated[ANT_SENSORS];
    believed(o, others);
    for (int i = 0; i < ANT_SENSORS; i++) {
        repeated[i] = ant_equal(said[i], o->read[i]);
        o->repeating[i] = repeated[i] ? o->repeating[i] + ANT_DT : 0;
        o->frozen[i] = o->frozen[i] && repeated[i];
        others[i] = others[i] && !repeated[i];
    }
    for (int i = 0; i < ANT_SENSORS; i++) {
        if (repeated[i])
            suspect(o, i, previous, expected, read, others);
        else
            o->repeats[i] = 0;
    }
}

/* Whether the rival predicts the readings used as well as true ones. */
static int explains(const ant_observer *o, const ant_real read[ANT_SENSORS], const int used[ANT_SENSORS]) {
    for (int i = 0; i < ANT_SENSORS; i++) {
        const ant_real variance = ant_innovation_variance(o, &o->rival, i);
        ant_real width = variance > 0 ? ant_gate_width(&o->gates[i], variance) : ANT_NAN;
        if (width < ANT_GATE_JUMP[i]) width = ANT_GATE_JUMP[i];
        if (used[i] && !(ant_abs(read[i] - ant_foreseen(&o->rival, i)) <= width)) return 0;
    }
    return 1;
}

static void end_rivalry(ant_observer *o) {
    o->rivalled = 0;
    o->explained = 0;
    memset(o->contested, 0, sizeof o->contested);
}

/* Sets for how long a rival has to explain readings that begin at this distance from those expected. */
static void doubt(ant_observer *o, const ant_belief *expected, const ant_real read[ANT_SENSORS], const int rejected[ANT_SENSORS]) {
    int thrown = 0; /* the muscle of a snapped cable shortens at once: its pressure may jump */
    for (int i = 0; i < ANT_JOINTS; i++) thrown = thrown || rejected[i];
    o->explained = 0;
    o->doubted = ANT_HESITATION;
    for (int i = 0; i < (thrown ? ANT_JOINTS : ANT_SENSORS); i++) {
        const ant_real off = ant_abs(read[i] - ant_foreseen(expected, i));
        if (rejected[i] && !(off <= ANT_GATE_JUMP[i])) o->doubted = ANT_GATE_PATIENCE;
    }
}

/* A rival begins at the readings that are rejected. */
static void challenge(ant_observer *o, const ant_belief *expected, const ant_real read[ANT_SENSORS], const int rejected[ANT_SENSORS]) {
    doubt(o, expected, read, rejected);
    o->rival = *expected;
    o->rivalled = 1;
    ant_unsure(&o->rival, read, rejected);
}

/* Takes trust from regulators whose pressures are rejected, if an angle has jumped as well. */
static void loosen(ant_belief *rival, const int rejected[ANT_SENSORS]) {
    int lost = 0;
    for (int i = 0; i < ANT_JOINTS; i++) lost = lost || rejected[i];
    for (int i = ANT_JOINTS; lost && i < ANT_SENSORS; i++) {
        const ant_real deviation = ANT_GATE_JUMP[i] / ANT_SIGMAS;
        if (rejected[i]) rival->covariance[ant_measured(i)][ant_measured(i)] += deviation * deviation;
    }
}

/* Writes to `expected` the prediction of a rival that has explained the rejected readings for long enough. */
static void rival_or(ant_observer *o, ant_belief *expected, const ant_real read[ANT_SENSORS]) {
    int rejected[ANT_SENSORS], used[ANT_SENSORS], any = 0, contested = 0, fresh = 0;
    ant_real repeating = 0;
    believed(o, used);
    for (int i = 0; i < ANT_SENSORS; i++) {
        rejected[i] = o->verdicts[i] == ANT_REJECTED;
        any = any || rejected[i];
        used[i] = used[i] || rejected[i];
    }
    o->unrivalled = any ? 0 : o->unrivalled < ANT_LONG ? o->unrivalled + 1 : ANT_LONG;
    if (o->unrivalled > ANT_CROSSING) end_rivalry(o); /* not at once: it is near by chance when two motions cross */
    if (!o->rivalled && !any) return;
    if (o->rivalled) {
        ant_predict_belief(o, &o->rival, 0, ANT_Q_NOISE);
        if (o->doubted >= ANT_GATE_PATIENCE) loosen(&o->rival, rejected);
    }
    for (int i = 0; i < ANT_JOINTS; i++) fresh = fresh || (rejected[i] && !o->contested[i]);
    if (!o->rivalled || !explains(o, read, used))
        challenge(o, expected, read, rejected);
    else if (fresh)
        doubt(o, expected, read, rejected);
    for (int i = 0; i < ANT_SENSORS; i++) {
        o->contested[i] = o->contested[i] || rejected[i];
        contested = contested || (used[i] && o->contested[i]);
        if (o->contested[i] && o->repeating[i] > repeating) repeating = o->repeating[i];
    }
    if (repeating > ANT_REPEATED) o->doubted = ANT_GATE_PATIENCE; /* as a blow does not, but a sensor that sticks */
    if (!(repeating > 0 && repeating <= ANT_REPEATED)) o->explained += contested;
    if (!any || (o->explained <= o->doubted && o->samples > ANT_FIRST)) {
        ant_correct(o, &o->rival, read, used);
        return;
    }
    for (int i = 0; i < ANT_SENSORS; i++)
        if (rejected[i]) {
            o->verdicts[i] = ANT_ACCEPTED;
            ant_gate_reset(&o->gates[i]);
        }
    *expected = o->rival;
    end_rivalry(o);
    memset(o->repeats, 0, sizeof o->repeats);
}

/* A state from the readings if that of the filter is not finite. */
static void rebuild(ant_observer *o, const ant_belief *previous, const ant_real read[ANT_SENSORS], const int there[ANT_SENSORS]) {
    if (o->rebuilt < ANT_LONG) o->rebuilt++;
    end_rivalry(o);
    memset(o->repeats, 0, sizeof o->repeats);
    for (int i = 0; i < ANT_BELIEFS; i++) {
        const int moves = (ANT_JOINTS <= i && i < 2 * ANT_JOINTS) || i >= ANT_STATES; /* a rate or a disturbance */
        const int kept = !moves && isfinite(previous->xi[i]);
        o->belief.xi[i] = kept ? previous->xi[i] : 0;
    }
    ant_within(o->belief.xi);
    ant_unsure(&o->belief, read, there);
}

/* Updates the distances of the pressures of quick and of slow regulators from those of the model. */
static void move_apart(ant_observer *o, const ant_belief *previous) {
    for (int i = 0; i < ANT_MUSCLES; i++) {
        const int sensor = ANT_JOINTS + i;
        const ant_real P = ant_clip(previous->xi[ant_measured(sensor)], ANT_GATE_LOWER[sensor], ANT_GATE_UPPER[sensor]);
        const ant_real e = ant_acting(i, o->commands[0][i], P) - P;
        for (int k = 0; k < 2; k++) o->apart[k][i] += ANT_SHARES[k][i] * (e - o->apart[k][i]) - (1 - ANT_KEPT[i]) * e;
    }
}

static void check(ant_observer *o, const ant_belief *expected, const ant_real read[ANT_SENSORS]) {
    for (int i = 0; i < ANT_SENSORS; i++) {
        ant_real least = 0, most = 0;
        for (int k = 0; k < 2 && i >= ANT_JOINTS; k++) {
            const ant_real apart = o->apart[k][i - ANT_JOINTS];
            if (apart < least) least = apart;
            if (apart > most) most = apart;
        }
        const ant_real value = ant_foreseen(expected, i);
        o->verdicts[i] = ant_check_reading(&o->gates[i], i, read[i], value + least, value + most,
                                           ant_innovation_variance(o, expected, i));
    }
}

/* From the last estimate to the present one. */
static void go_on(ant_observer *o, const ant_real said[ANT_SENSORS]) {
    const ant_belief previous = o->belief;
    ant_belief expected = o->belief;
    ant_contact contacts[ANT_JOINTS];
    ant_contacts_of(&previous, contacts);
    for (int i = 0; i < ANT_JOINTS; i++) ant_friction_follow(&o->friction[i], i, previous.xi[i], contacts[i]);
    ant_predict_belief(o, &expected, 0, ANT_Q_NOISE);
    move_apart(o, &previous);
    ant_real read[ANT_SENSORS];
    int there[ANT_SENSORS], rested[ANT_SENSORS], rests = 0;
    for (int i = 0; i < ANT_JOINTS; i++) read[i] = ant_unwrapped(said[i], expected.xi[i], ANT_NEAR_A_TURN);
    for (int i = 0; i < ANT_MUSCLES; i++) read[ANT_JOINTS + i] = said[ANT_JOINTS + i] - o->offset[i];
    if (!ant_sound(&expected)) {
        for (int i = 0; i < ANT_SENSORS; i++) o->verdicts[i] = ant_first_verdict(i, said[i]);
        believed(o, there);
        rebuild(o, &previous, said, there);
        return;
    }
    check(o, &expected, read);
    for (int i = 0; i < ANT_SENSORS; i++) {
        rested[i] = o->verdicts[i] == ANT_ACCEPTED;
        rests = rests || rested[i];
    }
    if (rests) ant_unsure(&expected, read, rested);
    without_frozen(o, &previous, &expected, said, read);
    rival_or(o, &expected, read);
    believed(o, there);
    for (int i = 0; i < ANT_MUSCLES; i++) {
        const ant_real P = expected.xi[2 * ANT_JOINTS + i];
        const int learns = all(there) && there[ANT_JOINTS + i] && ant_abs(o->commands[0][i] - P) <= ANT_SETTLED;
        const ant_real error = learns ? read[ANT_JOINTS + i] - P : 0;
        o->offset[i] = ant_clip(o->offset[i] + ANT_LEARNING * error, -ANT_MOST_OFFSET, ANT_MOST_OFFSET);
    }
    ant_correct(o, &expected, read, there);
    if (o->samples <= ANT_FIRST) o->samples++;
    o->belief = expected;
    if (!ant_sound(&o->belief)) rebuild(o, &previous, read, there);
}

/* The belief of now; that of the observer is of when the angle was read. */
static ant_belief ahead(const ant_observer *o) {
    ant_belief now = o->belief;
    for (int k = 1; k <= ANT_AGE; k++) ant_predict_belief(o, &now, k, ANT_Q_NOISE);
    return ant_sound(&now) ? now : o->belief;
}

static void answer(const ant_observer *o, const ant_real said[ANT_SENSORS], ant_real x[ANT_STATES],
                   ant_real d[ANT_JOINTS]) {
    const ant_belief now = o->begun ? ahead(o) : o->belief;
    for (int i = 0; i < ANT_JOINTS; i++) {
        x[ANT_JOINTS + i] = o->begun ? now.xi[ANT_JOINTS + i] : ANT_NAN;
        d[i] = o->begun ? now.xi[ANT_STATES + i] : 0;
    }
    for (int i = 0; i < ANT_SENSORS; i++) {
        const int there = o->verdicts[i] <= ANT_ACCEPTED;
        ant_real known = o->begun ? now.xi[ant_measured(i)] : said[i];
        if (o->begun ? o->silent[i] > ANT_TOLERANCE_END : !there) known = ANT_NAN;
        x[ant_measured(i)] = known;
    }
}

/* Readings of an encoder change by whole steps: the least change so far is its step, if any. */
static void learn_step(ant_observer *o, int joint, ant_real change) {
    if (change > ANT_ROUNDING && change < o->step[joint]) {
        const ant_real fine = ANT_ENCODER_NOISE, steps = change / ANT_F(sqrt)(12), rough = steps > fine ? steps : fine;
        const ant_real floor = ANT_ROUGH * rough;
        o->step[joint] = change;
        o->noise[joint] = rough * rough;
        o->gates[joint].floor = floor > ANT_GATE_FLOOR[joint] ? floor : ANT_GATE_FLOOR[joint];
    }
}

/* The new angles, with the pressures of when they were read. */
static void simultaneous(ant_observer *o, const ant_reading *reading, ant_real said[ANT_SENSORS]) {
    for (int k = 0; k <= ANT_AGE; k++)
        memcpy(o->held[k], k < ANT_AGE && o->holds ? o->held[k + 1] : reading->P, sizeof reading->P);
    o->holds = 1;
    memcpy(said, reading->theta, sizeof reading->theta);
    memcpy(said + ANT_JOINTS, o->held[0], sizeof o->held[0]);
}

void ant_estimate(ant_observer *o, const ant_reading *reading, const ant_real sent[ANT_MUSCLES], ant_real x[ANT_STATES],
                  ant_real d[ANT_JOINTS]) {
    ant_real said[ANT_SENSORS];
    simultaneous(o, reading, said);
    if (o->begun) {
        for (int i = 0; i < ANT_JOINTS; i++) learn_step(o, i, ant_abs(said[i] - o->read[i]));
        remember(o, sent);
        go_on(o, said);
    } else {
        begin(o, said, sent);
    }
    for (int i = 0; i < ANT_SENSORS; i++) {
        const ant_real least = o->frozen[i] && o->repeating[i] > o->silent[i] ? o->repeating[i] : o->silent[i];
        o->silent[i] = o->verdicts[i] <= ANT_ACCEPTED ? 0 : least + ANT_DT;
    }
    memcpy(o->read, said, sizeof o->read);
    answer(o, said, x, d);
}
