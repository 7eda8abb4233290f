"""Condensing, solution and certificate of the QP of a step."""
