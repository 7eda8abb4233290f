/* A step, with the stages of mpc/tracking/base.py: inputs checked, feed-forward, optimise, ladder, plan. */
#include <string.h>

#include "control.h"
#include "tables.h"

typedef struct {
    ant_plan_status status;
    int found; /* whether u of `rung` was */
    ant_rung rung;
} outcome;

/* u + E z, within the limits. */
static void move(ant_real step, ant_real u[ANT_HORIZON][ANT_MUSCLES], const ant_real z[ANT_MOVES],
                 const ant_real u_last[ANT_MUSCLES]) {
    ant_real sum[ANT_MUSCLES] = {0};
    for (int k = 0, b = 0; k < ANT_HORIZON; k++) {
        const int begins = b < ANT_BLOCKS && ANT_STARTS[b] == k;
        for (int i = 0; i < ANT_MUSCLES; i++) {
            if (begins) sum[i] += z[ANT_MUSCLES * b + i];
            u[k][i] += ANT_BAR * sum[i];
        }
        b += begins;
    }
    ant_limited(step, u_last, u);
}

/* The commands after ANT_ITERATIONS QPs, or up to one that failed; unproved ones if it was the first. */
static outcome optimise(ant_controller *c, const ant_task *task, const ant_real u_last[ANT_MUSCLES],
                        ant_real u[ANT_HORIZON][ANT_MUSCLES], ant_plan *plan) {
    outcome o = {ANT_PLAN_OPTIMAL, 0, ANT_RUNG_QP};
    ant_real z[ANT_MOVES] = {0};
    ant_shift(c, u_last, u);
    for (int round = 0; round < ANT_ITERATIONS; round++) {
        const ant_real gap = plan->gap;
        memcpy(c->qp.motion.u, u, sizeof c->qp.motion.u);
        const int finite = ant_linearise(c, task);
        if (round == 0) ant_expect_shifted(c);
        const ant_plan_status status = finite ? ant_solve(c, u_last, z, plan) : ANT_PLAN_NOT_FINITE;
        if (status != ANT_PLAN_OPTIMAL) {
            if (o.found) {
                plan->gap = gap;
                break;
            }
            o.status = status;
            o.rung = ANT_RUNG_SOFTENED;
            o.found = finite;
            if (o.found) move(c->qp.tuning->step, u, z, u_last);
            break;
        }
        move(c->qp.tuning->step, u, z, u_last);
        o.found = 1;
    }
    return o;
}

/* The pressures of a rest, approached as the limits allow. */
static outcome resting_at(ant_controller *c, const ant_real u_last[ANT_MUSCLES], ant_real u[ANT_HORIZON][ANT_MUSCLES]) {
    for (int k = 0; k < ANT_HORIZON; k++)
        for (int i = 0; i < ANT_MUSCLES; i++) u[k][i] = ant_rest_pressure(&c->rest, i);
    ant_limited(c->qp.tuning->step, u_last, u);
    return (outcome){ANT_PLAN_RESTING, 1, ANT_RUNG_ALLOCATION};
}

/* Writes the commands of this rung, which are not optimised, and their motion to c->motion; whether it is usable. */
static int try_rung(ant_controller *c, ant_rung rung, const ant_task *task, const outcome *o,
                    const ant_real u_last[ANT_MUSCLES]) {
    ant_motion *m = &c->motion;
    if (rung == ANT_RUNG_HOLD)
        ant_hold(c, u_last, m->u);
    else if (o->status == ANT_PLAN_BLIND || o->status == ANT_PLAN_BAD_INPUT)
        return 0;
    else if (rung == ANT_RUNG_PREVIOUS) {
        if (c->left <= 1) return 0;
        ant_shift(c, u_last, m->u);
    } else if (rung == ANT_RUNG_ALLOCATION) {
        if (!c->feed.finite) return 0;
        memcpy(m->u, c->feed.u, sizeof m->u);
        ant_limited(c->qp.tuning->step, u_last, m->u);
    } else
        return 0;
    return ant_rollout(task->x, task->d, m);
}

/* No motion: the second sample of the last plan is held, or the state if there is no plan. */
static void stationary(ant_controller *c, const ant_task *task) {
    for (int k = 0; k <= ANT_HORIZON; k++) {
        memcpy(c->motion.x[k], c->begun ? c->last.x[1] : task->x, sizeof c->motion.x[k]);
        for (int i = 0; i < ANT_MUSCLES; i++) c->motion.F[k][i] = c->begun ? c->last.F[1][i] : 0;
        for (int i = 0; i < ANT_STIFFNESSES; i++) c->motion.K[k][i] = c->begun ? c->last.K[1][i] : 0;
    }
}

static ant_rung descend(ant_controller *c, const ant_task *task, const outcome *o, const ant_real u_last[ANT_MUSCLES],
                        ant_real best[ANT_HORIZON][ANT_MUSCLES]) {
    if (o->found) {
        memcpy(c->motion.u, best, sizeof c->motion.u);
        if (ant_rollout(task->x, task->d, &c->motion)) return o->rung;
    }
    for (int rung = ANT_RUNG_PREVIOUS; rung <= ANT_RUNG_HOLD; rung++)
        if (try_rung(c, (ant_rung)rung, task, o, u_last)) return (ant_rung)rung;
    stationary(c, task);
    return ANT_RUNG_HOLD;
}

static void report(ant_controller *c, ant_plan *plan) {
    memcpy(plan->x, c->last.x, sizeof plan->x);
    for (int k = 0; k <= ANT_HORIZON; k++)
        for (int i = 0; i < ANT_STIFFNESSES; i++) plan->K[k][i] = c->last.K[k][i] / ANT_SVEC[i];
    ant_real beyond[2];
    const ant_motion *m = &c->last;
    const ant_qp_setting setting = ant_setting_of(c->qp.tuning);
    ant_excess(setting.bounds.left, setting.bounds.right, setting.bounds.min_force, (const ant_real(*)[ANT_STATES])m->x,
               (const ant_real(*)[ANT_MUSCLES])m->F, beyond);
    plan->slack = beyond[0];
    plan->slack_force = beyond[1];
    memcpy(plan->moved, c->feed.moved, sizeof plan->moved);
}

static ant_plan_status status_of(const outcome *o, ant_rung rung, int measured) {
    if (o->status != ANT_PLAN_OPTIMAL) return o->status;
    if (rung != ANT_RUNG_QP) return ANT_PLAN_NOT_FINITE; /* the QP was solved, but its predicted motion is not finite */
    return measured ? ANT_PLAN_OPTIMAL : ANT_PLAN_NO_MEASUREMENT;
}

void ant_control(ant_controller *c, const ant_real x[ANT_STATES], const ant_real d[ANT_JOINTS],
                 const ant_reference *reference, ant_plan *plan) {
    ant_task task;
    ant_preview(c, x, d, reference, &task);
    ant_real u_last[ANT_MUSCLES];
    for (int i = 0; i < ANT_MUSCLES; i++) u_last[i] = c->begun ? c->last.u[0][i] : c->sent[i];
    if (task.refused)
        memset(c->feed.moved, 0, sizeof c->feed.moved);
    else
        ant_feed_forward(&task, c->qp.tuning->min_force, &c->feed);
    ant_real best[ANT_HORIZON][ANT_MUSCLES];
    const outcome halted = {task.refused ? ANT_PLAN_BAD_INPUT : ANT_PLAN_BLIND, 0, ANT_RUNG_QP};
    const int rests = ANT_RESTS && ant_rest_follow(&c->rest, &task), halts = task.refused || task.lost;
    plan->exchanges = 0;
    plan->gap = 0;
    const outcome o = halts   ? halted
                      : rests ? resting_at(c, u_last, best)
                              : optimise(c, &task, u_last, best, plan);
    plan->rung = descend(c, &task, &o, u_last, best);
    ant_remember(c, plan->rung);
    if (!task.refused && c->feed.finite) {
        memcpy(c->u_star, c->feed.u[0], sizeof c->u_star);
        c->starred = 1;
    }
    plan->status = status_of(&o, plan->rung, task.measured);
    if (plan->rung > ANT_RUNG_SOFTENED) plan->gap = ANT_INFINITY;
    report(c, plan);
    ant_send(c, plan, rests ? ant_rest_side(&c->rest) : 0);
}

void ant_step(ant_controller *c, const ant_reading *reading, const ant_reference *reference, ant_plan *plan) {
    ant_real x[ANT_STATES], d[ANT_JOINTS];
    ant_estimate(&c->observer, reading, c->begun ? c->sent : reading->P, x, d);
    ant_control(c, x, d, reference, plan);
}

void ant_reset(ant_controller *c) {
    memset(c, 0, sizeof *c);
    c->exchange_limit = ANT_EXCHANGES;
    ant_rest_clear(&c->rest);
    c->qp.tuning = &ANT_TUNING;
}
