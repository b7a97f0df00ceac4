"""The results of a solve: displacement, fields on the surfaces, energies, forces, counts."""
