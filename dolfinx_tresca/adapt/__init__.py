"""Adaptive refinement until the requested accuracy is reached.

`solve_adaptively` is one loop: the user's function makes a problem on a mesh, the problem is
solved, the error is judged, and the cells that have most of the squared error together are cut
(Doerfler's marking). A *level* is a mesh with its solution; its *judgement* is the error of each
cell, of the energy or of a goal. `refine` bisects cells by `dolfinx.mesh.refine`, carries tags and
exact geometry to the new mesh, and distributes it over the ranks.

Symbols: eta, the estimated error of a cell, is `cell_errors`; theta of Doerfler's marking is
`fraction`.

Read first: `solve.solve_adaptively`, `solve.judged`, `refinement.refine`.
"""
