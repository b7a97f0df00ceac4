"""Nonlinear bodies: Newton's method whose every step is a contact problem."""
