"""The kernels are one text, the exact allocation in plain numbers: it is called, looped over, compiled and printed."""
