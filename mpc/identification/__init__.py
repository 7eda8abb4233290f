"""Plants identified from logs: their files, the errors of these files, and the command `antagonist fit-motion`."""
