"""Adaptive refinement until the requested accuracy is reached.

`solve_adaptively` is one loop: the user's function makes a problem on a mesh, the problem is
solved, the error is judged, and the cells that have most of the squared error together are cut
(Doerfler's marking). A *level* is a mesh with its solution, and with the estimated error, in the
energy norm or of a goal, as a whole and of each cell. `refine` bisects cells by
`dolfinx.mesh.refine`, carries tags over, moves new nodes to curved surfaces, and repartitions.

Symbols: eta, the estimated error of a cell, is `cell_errors`; theta of Doerfler's marking is
`fraction`.

Read first: `solve.solve_adaptively`, `solve.judged`, `refinement.refine`.
"""
