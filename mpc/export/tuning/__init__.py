"""What is tuned on the bench goes to an exported controller as numbers, which need no compiler."""

from mpc.export.tuning.entry import weights_from, write_tuning

__all__ = ["weights_from", "write_tuning"]
