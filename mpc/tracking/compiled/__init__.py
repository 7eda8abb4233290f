"""Compiled step of the controller, by numba; nothing of it, nor numba, is imported before it is needed.

The QP's solver is written once, in `structured_qp`: `stage`, `riccati`, `newton`, `certificate`, and in double
precision `rows`, `interior`, `multipliers` and `solve`, are printed as C (`mpc.export.controller.recursions`), with the
functions of `commands` that they use. Other parts are written in C under the same names (`mpc/export/c`):

    step.feed_forward        mpc/feedforward.c, ant_feed_forward
    step.linearise           mpc/structured.c, ant_linearise
    step.rollout             mpc/rollout.c, ant_rollout
    structured_qp.structured mpc/structured.c: ant_solve
    mpc.tracking.base        mpc/controller.c; preview, fallback, rest, softened have files of their names
    mpc.tracking.qp.condense dense/condense.c, with rows.c and certificate.c; for single precision only
"""
