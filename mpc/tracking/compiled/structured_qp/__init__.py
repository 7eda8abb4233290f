"""Structured solution of a step's QP, sample by sample: sweeps, interior point, and the proof."""
