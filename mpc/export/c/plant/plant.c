/* A step of the plant; its equations are in plant_model.c, derived by CasADi. */
#include "plant.h"

#include <math.h>
#include <string.h>

#include "plant_model.h"

void ant_plant_begin(ant_plant *p, const double x[ANT_PLANT_X]) {
    ant_model_plant_begin(x, p->full);
    for (int k = 0; k < ANT_PLANT_QUEUE; k++) memcpy(p->waiting[k], x + ANT_PLANT_P, sizeof p->waiting[k]);
}

void ant_plant_advance(ant_plant *p, const double u[ANT_PLANT_MUSCLES], const double d[ANT_PLANT_JOINTS]) {
    static const double pieces[ANT_PLANT_PIECES] = ANT_PLANT_DURATIONS;
    static const int steps[ANT_PLANT_PIECES] = ANT_PLANT_STEPS;
    memcpy(p->waiting[ANT_PLANT_WAITING], u, sizeof p->waiting[0]);
    for (int piece = 0; piece < ANT_PLANT_PIECES; piece++) {
        const double h = pieces[piece] / steps[piece];
        for (int k = 0; k < steps[piece]; k++) {
            double later[ANT_PLANT_STATES];
            ant_model_plant_step(p->full, p->waiting[piece], d, &h, later);
            memcpy(p->full, later, sizeof later);
        }
    }
    for (int k = 0; k < ANT_PLANT_WAITING; k++) memcpy(p->waiting[k], p->waiting[k + 1], sizeof p->waiting[k]);
}

ant_plant_outputs ant_plant_look(const ant_plant *p) {
    ant_plant_outputs y;
    ant_model_plant_outputs(p->full, y.K, y.T, y.F);
    for (int i = 0; i < ANT_PLANT_JOINTS; i++)
        y.theta[i] = ANT_PLANT_ENCODER > 0 ? ANT_PLANT_ENCODER * rint(p->full[i] / ANT_PLANT_ENCODER) : p->full[i];
    return y;
}
