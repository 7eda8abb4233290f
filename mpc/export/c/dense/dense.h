/* The dense form of the QP, for DAQP. */
#ifndef ANT_DENSE_H
#define ANT_DENSE_H

#include "control.h"

/* condense.c */
int ant_condense(ant_controller *c, const ant_real u_last[2]); /* whether all is finite */

/* least_squares.c: R (n, n) upper triangular by rows, |R z + v|^2/2 the cost of the rows rotated in */
static inline int ant_at(int n, int i) { return i * n - i * (i - 1) / 2 - i; } /* row i begins there, less i */
/* Adds |row z + r|^2/2; neither row nor R, but for its diagonal, may have anything behind the `used` first columns. */
void ant_rotate_in(int n, int used, ant_real *R, ant_real *v, ant_real *row, ant_real r); /* row is used up */
ant_real ant_cost(int n, const ant_real *R, const ant_real *v, const ant_real *z);        /* above that of z = 0 */

/* rows.c: limits, counted from 0 to ANT_LIMITS: the bounds of the decisions, and then the rows */
typedef struct {
    ant_real lower, upper;
} ant_bound;
ant_bound ant_bound_of(const ant_qp *qp, int limit);
void ant_row(const ant_qp *qp, int i, ant_real row[ANT_DECISIONS]);
void ant_row_values(const ant_qp *qp, const ant_real z[ANT_DECISIONS], ant_real value[ANT_ROWS]); /* of all rows */
ant_real ant_breach(const ant_qp *qp, int i, ant_real value); /* of row i; negative inside */

/* certificate.c */
int ant_certified(const ant_qp *qp, const ant_real z[ANT_DECISIONS], const ant_real multipliers[ANT_LIMITS]);

#endif /* ANT_DENSE_H */
