"""Back-ends that solve the allocation problem by general optimisation."""
