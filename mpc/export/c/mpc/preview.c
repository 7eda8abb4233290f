/* A command given now acts after the dead time. Until then the joints follow the commands under way; their motion
 * gives the state in which the new command begins to act. The torques on the way and beyond contain the friction of the
 * intended motion. The command is the inverse of the dead band at the pressure that should act, within its limits. */
#include <string.h>

#include "control.h"
#include "model.h"
#include "tables.h"

enum { N = ANT_JOINTS };

static int sensible(const ant_reference *r, const ant_real d[N]) {
    for (int k = 0; k <= ANT_AHEAD; k++) {
        for (int i = 0; i < N; i++)
            if (!(ant_abs(r->theta[k][i]) <= 2 * ANT_PI)) return 0;
        if (!ant_finite(r->K[k], ANT_STIFFNESSES) || !ant_positive_definite(r->K[k])) return 0;
    }
    return ant_finite(d, N);
}

static void expect(ant_controller *c, const ant_real x[ANT_STATES]) {
    if (!ant_finite(x, ANT_STATES)) return;
    memcpy(c->expected, x, sizeof c->expected);
    c->predicted = 1;
}

/* The initial state: missing or impossible numbers are replaced by the expected ones. */
static void state(ant_controller *c, const ant_real measured[ANT_STATES], ant_task *task) {
    int angles = 1;
    task->measured = 1;
    for (int i = 0; i < ANT_STATES; i++) {
        const int speed = N <= i && i < 2 * N, sensor = i < N ? i : i - N;
        const ant_real low = speed ? -ANT_MAX_SPEED : ANT_GATE_LOWER[sensor];
        const ant_real high = speed ? ANT_MAX_SPEED : ANT_GATE_UPPER[sensor];
        const ant_real otherwise = speed   ? 0
                                   : i < N ? (ANT_LEAST_ANGLE[i] + ANT_MOST_ANGLE[i]) / 2
                                           : ANT_SUPPLY_LO;
        const int known = low <= measured[i] && measured[i] <= high;
        task->x[i] = known ? measured[i] : c->predicted ? c->expected[i] : otherwise;
        task->measured = task->measured && known;
        if (i < N) angles = angles && known;
    }
    c->blind = angles ? 0 : c->blind < ANT_LONG ? c->blind + 1 : c->blind;
    c->seen = c->seen || angles;
}

/* References that cannot be meant: to stay. */
static void substitute(ant_controller *c, const ant_real x[ANT_STATES]) {
    for (int k = 0; k <= ANT_AHEAD; k++) memcpy(c->stay[k], x, sizeof c->stay[k]);
}

/* Torques from outside less the friction of joints that move on from x as the preview does. */
static void torques(ant_controller *c, const ant_real x[ANT_STATES], const ant_real d[N], const ant_real (*theta)[N]) {
    const ant_real corrected = ant_rest_rings(&c->rest) ? 0 : ANT_CORRECTED;
    ant_contact contacts[N];
    ant_contacts_at(x, contacts);
    for (int i = 0; i < N; i++) {
        ant_real memory[ANT_ELEMENTS], previous = theta[0][i] + corrected * (x[i] - theta[0][i]);
        if (!isfinite(contacts[i].strength)) contacts[i].strength = 0; /* the motion will not be finite, either */
        ant_friction_follow(&c->friction[i], i, x[i], contacts[i]);
        memcpy(memory, c->friction[i].memory, sizeof memory);
        c->d[0][i] = d[i] - ant_friction_torque(memory, i, contacts[i]);
        for (int k = 1; k <= ANT_AHEAD; k++) {
            ant_friction_move(memory, i, theta[k][i] - previous, contacts[i]);
            previous = theta[k][i];
            c->d[k][i] = d[i] - ant_friction_torque(memory, i, contacts[i]);
        }
    }
}

/* Moves the state on to when a command given now acts. */
static void wait(ant_controller *c, ant_real x[ANT_STATES]) {
    for (int k = 0; k < ANT_DELAY; k++) {
        ant_real later[ANT_STATES];
        ant_model_stage(x, c->waiting[k], c->d[k], later);
        if (k == 0) expect(c, later);
        memcpy(x, later, sizeof later);
    }
}

void ant_preview(ant_controller *c, const ant_real x[ANT_STATES], const ant_real d[N], const ant_reference *r,
                 ant_task *task) {
    static const ant_real none[N];
    task->refused = !sensible(r, d);
    for (int i = 0; i < N; i++) task->expected[i] = c->predicted ? c->expected[i] : ANT_NAN;
    state(c, x, task);
    memcpy(task->seen, task->x, sizeof task->seen);
    if (task->refused) substitute(c, task->x);
    for (int i = 0; i < N && !c->seen && !task->refused; i++)
        task->x[i] = ant_clip(r->theta[0][i], ANT_LEAST_ANGLE[i], ANT_MOST_ANGLE[i]);
    torques(c, task->x, task->refused ? none : d, task->refused ? (const ant_real(*)[N])c->stay : r->theta);
    if (!c->begun) {
        for (int i = 0; i < ANT_MUSCLES; i++) c->sent[i] = ant_commandable(task->x[2 * N + i]);
        for (int k = 0; k <= ANT_DELAY; k++) memcpy(c->waiting[k], &task->x[2 * N], sizeof c->waiting[k]);
    }
    wait(c, task->x);
    task->theta = r->theta + ANT_DELAY;
    task->K = r->K + ANT_DELAY;
    task->d = (const ant_real(*)[N])c->d + ANT_DELAY;
    task->lost = !c->seen || (ant_real)c->blind * ANT_DT > ANT_PATIENCE;
}

void ant_send(ant_controller *c, ant_plan *plan, ant_real side) {
    const ant_motion *m = &c->last;
    if (ANT_DELAY == 0) expect(c, m->x[1]);
    memcpy(c->waiting[ANT_DELAY], m->u[0], sizeof m->u[0]);
    for (int k = 0; k < ANT_DELAY; k++) memcpy(c->waiting[k], c->waiting[k + 1], sizeof c->waiting[k]);
    memcpy(plan->u, m->u, sizeof plan->u);
    if (ANT_DEAD_BAND > 0) {
        const int known = !ant_equal(side, 0);
        for (int k = 0; k < ANT_HORIZON; k++)
            for (int i = 0; i < ANT_MUSCLES; i++) {
                const ant_real u = m->u[k][i];
                plan->u[k][i] = known ? u + side * ANT_DEAD_BAND / 2 : ant_inverse_dead_band(u, m->x[k][2 * N + i]);
            }
        ant_limited(c->qp.tuning->step, c->sent, plan->u);
    }
    memcpy(c->sent, plan->u[0], sizeof c->sent);
}
