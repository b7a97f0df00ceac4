"""Algorithms for: minimise q(lambda) = 1/2 lambda'A lambda - lambda'b over lambda in Lambda, (38.4)."""
