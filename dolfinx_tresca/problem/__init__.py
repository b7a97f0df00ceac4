"""Contact problems: forms, pairs, boundary conditions and the solver for K, put together."""
