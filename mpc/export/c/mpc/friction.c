/* Friction with a memory of a joint's angle, T_f = strength * sum of k_i m_i, where strength depends on the state; and the
 * dead band of the pressure regulators. Dahl's model has one m' = (omega - |omega| m)/presliding; by Maxwell slip each
 * m_i follows the angle within a width, which grows with the pressures. */
#include "control.h"
#include "model.h"
#include "tables.h"

void ant_contacts_at(const ant_real x[ANT_STATES], ant_contact contacts[ANT_JOINTS]) {
    ant_real strength[ANT_JOINTS], scale[ANT_JOINTS];
    ant_model_friction(x, strength, scale);
    for (int i = 0; i < ANT_JOINTS; i++) contacts[i] = (ant_contact){strength[i], scale[i]};
}

#if ANT_SLIPS

static void begin(ant_real m[ANT_ELEMENTS], int joint, ant_real theta) {
    for (int i = 0; i < ANT_ELEMENTS; i++) m[i] = ANT_WIDTHS[joint][i] < ANT_NEVER ? 0 : theta;
}

void ant_friction_move(ant_real m[ANT_ELEMENTS], int joint, ant_real motion, ant_contact c) {
    for (int i = 0; i < ANT_ELEMENTS; i++) {
        const ant_real width = c.scale * ANT_WIDTHS[joint][i];
        m[i] = ant_clip(m[i] + motion, -width, width);
    }
}

ant_real ant_friction_torque(const ant_real m[ANT_ELEMENTS], int joint, ant_contact c) {
    ant_real sum = 0;
    for (int i = 0; i < ANT_ELEMENTS; i++) sum += ANT_SPRINGS[joint][i] * m[i];
    return c.strength * sum;
}

#else

static void begin(ant_real m[ANT_ELEMENTS], int joint, ant_real theta) {
    (void)joint, (void)theta;
    m[0] = 0;
}

void ant_friction_move(ant_real m[ANT_ELEMENTS], int joint, ant_real motion, ant_contact c) {
    (void)c;
    const ant_real s = motion > 0 ? 1 : motion < 0 ? -1 : 0;
    m[0] = s - (s - m[0]) * ANT_F(exp)(-ant_abs(motion) / ANT_PRESLIDING[joint]);
}

ant_real ant_friction_torque(const ant_real m[ANT_ELEMENTS], int joint, ant_contact c) {
    (void)joint;
    return c.strength * m[0];
}

#endif

void ant_friction_follow(ant_friction *f, int joint, ant_real theta, ant_contact c) {
    if (!f->known) {
        begin(f->memory, joint, theta);
        f->theta = theta;
        f->known = 1;
    }
    const ant_real motion = ant_abs(theta - f->theta) > ANT_JITTER ? theta - f->theta : 0;
    if (!ant_equal(motion, 0)) f->theta = theta;
    ant_friction_move(f->memory, joint, motion, c);
}

ant_real ant_after_dead_band(ant_real u, ant_real P) {
    const ant_real rest = ANT_DEAD_BAND / 2;
    return u - ant_clip(u - P, -rest, rest);
}

ant_real ant_inverse_dead_band(ant_real v, ant_real P) {
    return v + ANT_DEAD_BAND / 2 * ANT_F(tanh)((v - P) / ANT_SOFT);
}
