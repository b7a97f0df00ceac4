"""Pairing two surfaces: from geometry to the operators N and T."""
