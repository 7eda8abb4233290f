"""All commands have this in common: options of a joint, what may be written, how failures are told."""
