"""A guaranteed bound of the error of the displacement (docs/theory/guaranteed.md).

By Prager and Synge, the distance of the computed stress from any stress in equilibrium with the
loads bounds its error. `Stars` finds tractions on the facets of simplices that balance each cell;
a stress in each cell follows from them. Errors of contact and of loads that are not linear add up.

- `Simplices`, `MeshCells`: shapes and constants of any simplices, and of the cells of a rank.
- The *loading* of a cell: linear tractions on its facets, and a linear load in it. It stands for a
  stress that is in equilibrium with them; `StressEnergies` computes the norm of this stress.
- A *star*: the cells around a vertex, and the facets at the vertex.
- `ContactSurface`: admissible tractions of a pair, and by how much they miss the law of contact.
- `Candidate`: a loading that balances the loads, and a displacement v that does not penetrate.

Read first: `bound.Bodies.error`, `bound.Bodies.candidate`, `stars.Stars`.
"""
