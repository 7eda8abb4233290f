/* Interior-point method for QPs that the sweeps do not solve, in double precision. */
#include "control.h"

ant_plan_status ant_persist(ant_controller *c, const ant_real u_last[2], int count, ant_real z[ANT_DECISIONS],
                            int *iterations) {
    const ant_structured s = ant_structured_of(&c->qp);
    const ant_persistent_numbers found = ant_persistent(&s.path, &s.errors, &s.setting, s.u, &s.bounded, count,
                                                        c->qp.guess, &s.at, &s.work, c->iteration_limit);
    (void)u_last;
    *iterations = found._1;
    ant_decisions(&c->qp, z);
    return found._0 ? ANT_PLAN_OPTIMAL : ANT_PLAN_UNSOLVED;
}
