"""The bench in a terminal: commands that move a machine, their options, and the pictures of a run."""
