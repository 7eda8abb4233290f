"""Tracking controller: a linear time-varying MPC of angle and stiffness.

`base` has the stages of a step, `controller` and `cost` the optimisation problem. `qp.condense` builds the QP and
`qp.named` shows it; `fallback` chooses commands and status; `plan` holds the result.
"""
