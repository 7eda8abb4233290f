"""Structured solution of a step's QP, sample by sample: sweeps, the exchange of limits, and the proof."""
