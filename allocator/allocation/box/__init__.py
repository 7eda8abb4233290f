"""Allocation for m muscles at n joints: convex least squares in a box, level after level."""
