"""Algorithms that minimise q = 1/2 lambda'A lambda - lambda'b over Lambda, (38.4)."""
