"""Ask six muscles of a two-joint arm for torques and a stiffness matrix, and check why another one cannot be had."""

import numpy as np

from allocator import BAR
from allocator.mechanism import allocate_mechanism, machines

arm = machines.arm26()
q = np.array([0.4, -0.3])  # [rad]

a = allocate_mechanism(arm, q, [[10.0, 4.0], [4.0, 9.0]], [9.0, 4.0])
for name, P in zip(arm.muscle_names, a.P / BAR, strict=True):
    print(f"{name:22s} {P:.2f} bar")
print(a.status.name, "the posture holds itself" if a.holds else "the posture does not hold itself")

a = allocate_mechanism(arm, q, [[40.0, 4.0], [4.0, 9.0]], [9.0, 4.0])
print(a.status.name, a.message)
