"""A guaranteed bound of the error of the displacement (docs/theory/guaranteed.md).

By Prager and Synge, the distance of the computed stress from any stress in equilibrium with the
loads bounds its error. Such a stress is built cell by cell on simplices, from tractions on facets
that are in equilibrium around each vertex; what contact and curved loads lack is added.

- `Simplices`, `MeshCells`: shapes and constants of cells; those of a rank.
- The *loading* of a cell: linear tractions on its facets, and a linear load in it. It stands for a
  stress in equilibrium with it, whose norm `StressEnergies` has.
- A *star* is the cells around a vertex; `Stars` finds tractions in equilibrium on its facets.
- `ContactSurface`: admissible tractions of a pair, and what they lack of the law of contact.
- A *candidate* is a loading, and a displacement v that does not penetrate.

Read first: `bound.Bodies.error`, `bound.Bodies.candidate`, `stars.Stars`.
"""
