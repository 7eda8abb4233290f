"""Display of a running loop, in a process of its own."""
