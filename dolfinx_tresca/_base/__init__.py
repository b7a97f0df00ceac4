"""Helpers for all subpackages: array types, DOLFINx versions, MPI, PETSc owners, timing."""
