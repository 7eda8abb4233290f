/* The stiffness at a posture; its formulas are printed from the Python source (stiffness_model.c). */
#include "real.h"
#include "stiffness_model.h"

ant_stiffness ant_stiffness_at(ant_real theta, ant_real P1, ant_real P2, ant_real amplitude) {
    const ant_real at[4] = {theta, P1, P2, amplitude};
    ant_real found[5] = {ANT_NAN, ANT_NAN, ANT_NAN, ANT_NAN, ANT_NAN};
    const int numbers = isfinite(theta) && isfinite(P1) && isfinite(P2);
    if (numbers && amplitude > 0 && isfinite(amplitude)) ant_model_stiffness(at, found);
    const ant_stiffness answer = {found[0], found[1], {found[2], found[3]}, found[4]};
    return answer;
}
