"""The stiffness matrix K, the load f, and solvers for K u = f."""
