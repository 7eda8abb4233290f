"""The tracking controller is built here: a linear time-varying MPC of angle and stiffness.

A step, stage by stage, is in `base`; what it optimises in `controller` and `cost`; the QP is built in `qp.condense` and
shown by `qp.named`; `fallback` chooses commands and status; `plan` holds the result.
"""
