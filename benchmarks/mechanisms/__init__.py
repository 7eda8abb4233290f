"""Mechanisms: optimality of answers, proofs for unreachable targets, and times."""
