"""Benchmarks: test set, settings, report; each is one command, run from the checkout."""
