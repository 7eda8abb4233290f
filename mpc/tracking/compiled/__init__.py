"""The controller's step is compiled here by numba; nothing of it is imported before it is needed, nor numba with it.

The QP's solver is written once, in `structured_qp`: `stage`, `riccati`, `newton`, `certificate`, and in double
precision `rows`, `interior`, `multipliers` and `solve`, are printed as C (`mpc.export.controller.recursions`), and so
is what of `commands` they take. What has to be written in C, too, has the same names there (`mpc/export/c`):

    step.feed_forward        mpc/feedforward.c, ant_feed_forward
    step.linearise           mpc/structured.c, ant_linearise
    step.rollout             mpc/rollout.c, ant_rollout
    structured_qp.structured mpc/structured.c: ant_solve
    mpc.tracking.base        mpc/controller.c; preview, fallback, rest, softened have files of their names
    mpc.tracking.qp.condense dense/condense.c, with rows.c and certificate.c; for single precision only
"""
