"""The controller's step is compiled here by numba; nothing of it is imported before it is needed, nor numba with it.

What has to be written in C, too, has the same names there (`mpc/export/c/mpc`):

    step.feed_forward        feedforward.c, ant_feed_forward
    step.rollout             rollout.c, ant_rollout
    commands                 limits.c, ant_limit; slew_bounds in condense.c
    certificate              certificate.c
    mpc.tracking.qp.condense condense.c: acting, unroll; _rows is rows.c
    mpc.tracking.base        controller.c; preview, fallback, rest, softened have files of their names

C has no recursions (`stage`, `riccati`, `newton`, `rows`, `interior`): it gives the least-squares form of the QP to
DAQP (qp.c).
"""

__all__: list[str] = []
