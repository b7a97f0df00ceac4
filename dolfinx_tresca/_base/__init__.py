"""What every room may use: array types, versions of DOLFINx, MPI helpers, owners, timing."""
