"""The QP of a step is condensed and solved here, and its solution is proved."""
