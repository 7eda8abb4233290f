/* Friction that grows with the muscle forces, by Dahl's model: T_f = T_max z, z' = (omega - |omega| z)/presliding; and
 * the dead band of the pressure regulators. */
#include "control.h"
#include "model.h"

ant_real ant_friction_after(ant_real z, ant_real motion) {
    const ant_real s = motion > 0 ? 1 : motion < 0 ? -1 : 0;
    return s - (s - z) * ANT_F(exp)(-ant_abs(motion) / ANT_PRESLIDING);
}

ant_real ant_friction_follow(ant_friction *f, ant_real theta) {
    if (!f->known) {
        f->theta = theta;
        f->known = 1;
    }
    if (ant_abs(theta - f->theta) > ANT_JITTER) {
        f->z = ant_friction_after(f->z, theta - f->theta);
        f->theta = theta;
    }
    return f->z;
}

ant_real ant_friction_limit(const ant_real x[4]) {
    ant_real pull;
    ant_model_pull(x, &pull);
    return ANT_FRICTION * pull + ANT_COULOMB;
}

ant_real ant_after_dead_band(ant_real u, ant_real P) {
    const ant_real rest = ANT_DEAD_BAND / 2;
    return u - ant_clip(u - P, -rest, rest);
}

ant_real ant_inverse_dead_band(ant_real v, ant_real P) {
    return v + ANT_DEAD_BAND / 2 * ANT_F(tanh)((v - P) / ANT_SOFT);
}
