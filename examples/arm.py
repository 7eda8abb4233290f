"""Ask six muscles of a two-joint arm for torques and a stiffness matrix, and check why another one cannot be had."""

import numpy as np

from allocator import BAR, allocate
from allocator.mechanism import machines

arm = machines.arm26()
q = np.array([0.4, -0.3])  # [rad]

a = allocate(q, [[10.0, 4.0], [4.0, 9.0]], [9.0, 4.0], joint=arm)
for name, P in zip(arm.muscle_names, a.P / BAR, strict=True):
    print(f"{name:22s} {P:.2f} bar")
print(a.status.name, "the posture holds itself" if a.holds else "the posture does not hold itself")

a = allocate(q, [[40.0, 4.0], [4.0, 9.0]], [9.0, 4.0], joint=arm)
print(a.status.name, a.message)
