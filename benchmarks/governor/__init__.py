"""Governor: limits under arbitrary commands, also for all plants within known intervals."""
