"""Derivatives of solutions, and the errors of numbers that follow from adjoints."""
