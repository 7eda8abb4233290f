"""The tracking controller is built here: a linear time-varying MPC of angle and stiffness."""

__all__: list[str] = []
