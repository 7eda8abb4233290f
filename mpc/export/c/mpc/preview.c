/* A command given now acts after the dead time. Until then the joint follows the commands under way; their motion
 * gives the state in which the new command begins to act. The torque on the way and beyond contains the friction of the
 * intended motion. The command is the inverse of the dead band at the pressure that should act, within its limits. */
#include <string.h>

#include "control.h"
#include "model.h"
#include "tables.h"

static int sensible(const ant_reference *r, ant_real d) {
    for (int k = 0; k <= ANT_AHEAD; k++)
        if (!(ant_abs(r->theta[k]) <= 2 * ANT_PI) || !isfinite(r->K[k]) || !(r->K[k] > 0)) return 0;
    return isfinite(d);
}

static void expect(ant_controller *c, const ant_real x[4]) {
    if (!ant_finite(x, 4)) return;
    memcpy(c->expected, x, sizeof c->expected);
    c->predicted = 1;
}

/* The initial state: missing or impossible numbers are replaced by the expected ones. */
static void state(ant_controller *c, const ant_real measured[4], ant_task *task) {
    const ant_real otherwise[4] = {(ANT_LEFT + ANT_RIGHT) / 2, 0, ANT_SUPPLY_LO, ANT_SUPPLY_LO};
    task->measured = 1;
    for (int i = 0; i < 4; i++) {
        const ant_real low = i == 1 ? -ANT_MAX_SPEED : ANT_GATE_LOWER[i == 0 ? 0 : i - 1];
        const ant_real high = i == 1 ? ANT_MAX_SPEED : ANT_GATE_UPPER[i == 0 ? 0 : i - 1];
        const int known = low <= measured[i] && measured[i] <= high;
        task->x[i] = known ? measured[i] : c->predicted ? c->expected[i] : otherwise[i];
        task->measured = task->measured && known;
        if (i == 0) c->blind = known ? 0 : c->blind < ANT_LONG ? c->blind + 1 : c->blind;
        if (i == 0 && known) c->seen = 1;
    }
}

/* References that cannot be meant: to stay. */
static void substitute(ant_controller *c, const ant_real x[4]) {
    for (int k = 0; k <= ANT_AHEAD; k++) c->stay[k] = x[0];
}

/* Torque from outside less the friction of a joint that moves on from x as the preview does. */
static void torques(ant_controller *c, const ant_real x[4], ant_real d, const ant_real *theta) {
    const ant_real corrected = c->rest.ringing ? 0 : ANT_CORRECTED;
    ant_contact contact = ant_contact_at(x);
    ant_real memory[ANT_ELEMENTS], previous = theta[0] + corrected * (x[0] - theta[0]);
    if (!isfinite(contact.strength)) contact.strength = 0; /* the motion will not be finite, either */
    ant_friction_follow(&c->friction, x[0], contact);
    memcpy(memory, c->friction.memory, sizeof memory);
    c->d[0] = d - ant_friction_torque(memory, contact);
    for (int k = 1; k <= ANT_AHEAD; k++) {
        ant_friction_move(memory, theta[k] - previous, contact);
        previous = theta[k];
        c->d[k] = d - ant_friction_torque(memory, contact);
    }
}

/* Moves the state on to when a command given now acts. */
static void wait(ant_controller *c, ant_real x[4]) {
    for (int k = 0; k < ANT_DELAY; k++) {
        ant_real later[4];
        ant_model_stage(x, c->waiting[k], &c->d[k], later);
        if (k == 0) expect(c, later);
        memcpy(x, later, sizeof later);
    }
}

void ant_preview(ant_controller *c, const ant_real x[4], ant_real d, const ant_reference *r, ant_task *task) {
    task->refused = !sensible(r, d);
    task->expected = c->predicted ? c->expected[0] : ANT_NAN;
    state(c, x, task);
    memcpy(task->seen, task->x, sizeof task->seen);
    if (task->refused) substitute(c, task->x);
    if (!c->seen && !task->refused) task->x[0] = ant_clip(r->theta[0], ANT_LEFT, ANT_RIGHT);
    torques(c, task->x, task->refused ? 0 : d, task->refused ? c->stay : r->theta);
    if (!c->begun) {
        for (int i = 0; i < 2; i++) c->sent[i] = ant_commandable(task->x[2 + i]);
        for (int k = 0; k <= ANT_DELAY; k++) memcpy(c->waiting[k], &task->x[2], sizeof c->waiting[k]);
    }
    wait(c, task->x);
    task->theta = r->theta + ANT_DELAY;
    task->K = r->K + ANT_DELAY;
    task->d = c->d + ANT_DELAY;
    task->lost = !c->seen || (ant_real)c->blind * ANT_DT > ANT_PATIENCE;
}

void ant_send(ant_controller *c, ant_plan *plan, ant_real side) {
    const ant_motion *m = &c->last;
    if (ANT_DELAY == 0) expect(c, m->x[1]);
    memcpy(c->waiting[ANT_DELAY], m->u[0], sizeof m->u[0]);
    for (int k = 0; k < ANT_DELAY; k++) memcpy(c->waiting[k], c->waiting[k + 1], sizeof c->waiting[k]);
    memcpy(plan->u, m->u, sizeof plan->u);
    if (ANT_DEAD_BAND > 0) {
        for (int k = 0; k < ANT_HORIZON; k++)
            for (int i = 0; i < 2; i++) {
                const ant_real u = m->u[k][i];
                plan->u[k][i] = side != 0 ? u + side * ANT_DEAD_BAND / 2 : ant_inverse_dead_band(u, m->x[k][2 + i]);
            }
        ant_limited(c->qp.tuning->step, c->sent, plan->u);
    }
    memcpy(c->sent, plan->u[0], sizeof c->sent);
}
