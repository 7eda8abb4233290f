/* Two equal Tondu2021 muscles (arXiv 2104.13167) on a pulley. */
#include "exact.h"

ant_answer ant_exact(const ant_target *t) {
    return ant_tondu_exact(t->theta, t->K, t->T, t->min_force, t->max_force, t->P1_now, t->P2_now, t->max_step,
                           t->priority == ANT_STIFFNESS_FIRST);
}
