"""What the joint can do: which angles, stiffnesses and torques exist, and what ends them."""
