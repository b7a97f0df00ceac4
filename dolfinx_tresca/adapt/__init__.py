"""Adaptive refinement until the requested accuracy is reached.

`solve_adaptively` is one loop: the user's function makes a problem on a mesh, the problem is
solved, the error is judged, and the cells that have half of the squared error together are cut
(Doerfler's marking), until the mesh is twice as large. A *level* is a mesh with its solution; its
*judgement* is the error of each cell, of the energy or of a goal. A *cut* bisects cells by
`dolfinx.mesh.refine` and carries tags, exact geometry and expected errors to the new mesh.

Symbols: eta, the estimated error of a cell, is `cell_errors`; theta of Doerfler's marking is
`fraction`.

Read first: `solve.solve_adaptively`, `judgement.judged`, `refinement.cut`.
"""
