"""The tracking controller is built here: a linear time-varying MPC of angle and stiffness.

A step, stage by stage, is in `base`; what it optimises in `controller` and `cost`; the QP is built in `qp.condense` and
shown by `qp.named`; what is commanded, and with which status, is decided in `fallback`; `plan` is what comes of it.
"""
