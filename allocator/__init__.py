"""Pressures of an antagonistic pneumatic-muscle joint from torque and stiffness targets."""
