"""The QP of a step is solved here as it is, sample by sample: sweeps, interior point, and the proof."""
