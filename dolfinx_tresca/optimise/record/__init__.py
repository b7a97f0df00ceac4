"""Residuals and energies of iterates, the record of a solve, and its end."""
