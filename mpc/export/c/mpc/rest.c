/* Rest mode: the commands come to rest if the reference is constant; see src/resting.c. */
#include "control.h"
#include "model.h"
#include "tables.h"

enum { N = ANT_JOINTS };

/* Full matrices of the previewed stiffness. */
static void matrices(const ant_task *task, ant_real K[ANT_HORIZON + 1][N][N]) {
    for (int k = 0; k <= ANT_HORIZON; k++)
        for (int i = 0, entry = 0; i < N; i++)
            for (int j = i; j < N; j++) {
                K[k][i][j] = task->K[k][entry];
                K[k][j][i] = task->K[k][entry++];
            }
}

/* Corrects the mean errors of the joints. */
static void turn(ant_rest *r) {
    ant_real x[ANT_STATES] = {0}, K[N * N], slopes[N * ANT_MUSCLES];
    for (int i = 0; i < N; i++) x[i] = ant_rest_angle(r, i);
    for (int i = 0; i < ANT_MUSCLES; i++) x[2 * N + i] = ant_rest_pressure(r, i);
    ant_model_holding(x, K, slopes);
    ant_rest_turn(r, K, slopes);
}

int ant_rest_follow(ant_rest *r, const ant_task *task) {
    ant_real K[ANT_HORIZON + 1][N][N];
    matrices(task, K);
    const int known = task->measured && !task->refused;
    const int constant = known && ant_rest_constant(r, &ANT_REST_RULES, task->theta[0], K[0][0]);
    if (!constant) ant_rest_begin(r);
    if (constant && ant_rest_decided(r, &ANT_REST_RULES, task->seen, task->expected)) turn(r);
    return ant_rest_holds(r);
}
