"""Find the pressures for a torque and a stiffness of the report's joint, and see what limits them."""

from allocator import BAR, DEG, allocate, stiffness_interval

a = allocate(theta=30 * DEG, K=7.5, T=1.0)  # rad, N·m/rad, N·m
print(f"{a.status.name}: P1 = {a.P1 / BAR:.3f} bar, P2 = {a.P2 / BAR:.3f} bar")

low, high = stiffness_interval(30 * DEG, T=1.0)
print(f"stiffness can be {low:.2f} to {high:.2f} N·m/rad")

a = allocate(theta=30 * DEG, K=12.0, T=1.0)
print(f"{a.status.name}: {a.K:.2f} N·m/rad, in the way: {', '.join(a.active)}")
