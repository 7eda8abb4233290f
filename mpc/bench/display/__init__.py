"""The display shows a loop while it runs, from a process of its own."""
