"""An ordinary sample of the observer is made in one compiled call here, from flat arrays to flat arrays."""
