"""Back-ends solve the allocation problem by general optimisation."""
