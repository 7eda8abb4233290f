"""The tracking controller: a linear time-varying MPC of angle and stiffness."""

__all__: list[str] = []
