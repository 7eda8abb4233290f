/* The fallback ladder, best first: the QP, the softened QP, the previous plan at most to its end, the feed-forward
 * approached as the limits allow, and holding the pressures, which after a while are let out slowly in their ratio. */
#include <string.h>

#include "control.h"

/* The last plan moved on by one sample, its new end moving as the feed-forward does. */
void ant_shift(const ant_controller *c, const ant_real u_last[ANT_MUSCLES], ant_real u[ANT_HORIZON][ANT_MUSCLES]) {
    enum { last = ANT_HORIZON - 1 };
    memcpy(u, c->feed.u, sizeof c->feed.u);
    if (c->begun) {
        memcpy(u, c->last.u[1], last * sizeof u[0]);
        for (int i = 0; i < ANT_MUSCLES; i++) {
            const ant_real turn = c->feed.u[last][i] - c->feed.u[last - 1][i];
            u[last][i] = c->last.u[last][i] + (isfinite(turn) ? turn : 0);
        }
    }
    ant_limited(c->qp.tuning->step, u_last, u);
}

void ant_hold(const ant_controller *c, const ant_real u_last[ANT_MUSCLES], ant_real u[ANT_HORIZON][ANT_MUSCLES]) {
    ant_real held[ANT_MUSCLES];
    memcpy(held, u_last, sizeof held);
    for (int k = 0; k < ANT_HORIZON; k++) {
        if ((ant_real)(c->held + k) * ANT_DT >= ANT_HOLDING) {
            const ant_real step = ANT_VENTING * ANT_DT;
            ant_real highest = step;
            for (int i = 0; i < ANT_MUSCLES; i++)
                if (held[i] - ANT_SUPPLY_LO > highest) highest = held[i] - ANT_SUPPLY_LO;
            for (int i = 0; i < ANT_MUSCLES; i++) held[i] -= step / highest * (held[i] - ANT_SUPPLY_LO);
        }
        memcpy(u[k], held, sizeof held);
    }
    ant_limited(c->qp.tuning->step, u_last, u);
}

void ant_remember(ant_controller *c, ant_rung rung) {
    memcpy(&c->last, &c->motion, sizeof c->last);
    c->begun = 1;
    if (rung == ANT_RUNG_QP || rung == ANT_RUNG_SOFTENED)
        c->left = ANT_HORIZON;
    else
        c->left = rung == ANT_RUNG_PREVIOUS ? c->left - 1 : 0;
    c->held = rung == ANT_RUNG_HOLD ? (c->held < ANT_LONG ? c->held + 1 : c->held) : 0;
}
