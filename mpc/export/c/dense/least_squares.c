/* Least squares row by row: Givens rotations keep R upper triangular. Squaring nothing, they leave single precision as
 * many digits as it has; the normal equations would leave half of them. */
#include "dense.h"

void ant_rotate_in(int n, int used, ant_real *R, ant_real *v, ant_real *row, ant_real r) {
    for (int i = 0; i < used; i++) {
        if (row[i] == 0) continue;
        ant_real *Ri = R + ant_at(n, i);
        const ant_real length = ANT_F(sqrt)(Ri[i] * Ri[i] + row[i] * row[i]), c = Ri[i] / length, s = row[i] / length;
        const ant_real vi = v[i];
        for (int j = i; j < used; j++) {
            const ant_real above = Ri[j];
            Ri[j] = c * above + s * row[j];
            row[j] = c * row[j] - s * above;
        }
        v[i] = c * vi + s * r;
        r = c * r - s * vi;
    }
}

ant_real ant_cost(int n, const ant_real *R, const ant_real *v, const ant_real *z) {
    ant_real cost = 0;
    for (int i = 0; i < n; i++) {
        const ant_real *Ri = R + ant_at(n, i);
        ant_real Rz = 0;
        for (int j = i; j < n; j++) Rz += Ri[j] * z[j];
        cost += Rz * (Rz / 2 + v[i]);
    }
    return cost;
}
