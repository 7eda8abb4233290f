"""Compiled step of the controller, by numba; nothing of it, nor numba, is imported before it is needed.

The QP's solver is written once, in `structured_qp`, and printed as C (`mpc.export.controller.recursions`), with the
functions of `commands` that it uses. Other parts are written in C under the same names (`mpc/export/c`):

    step.feed_forward        mpc/feedforward.c, ant_feed_forward
    step.linearise           pair/path.c and arm/path.c, ant_linearise
    mpc.model.arm.compiled   arm/rate.c and mpc/motion.c, ant_advance
    step.rollout             mpc/rollout.c, ant_rollout
    structured_qp.structured mpc/structured.c: ant_solve
    mpc.tracking.base        mpc/controller.c; preview, fallback, rest have files of their names

The rest mode is printed from `mpc.tracking.resting` (`mpc.export.controller.sizes`).
"""
