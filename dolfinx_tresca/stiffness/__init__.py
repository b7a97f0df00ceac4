"""The linear system K u = f of the bodies, without contact, and the solvers for it.

- `LinearSystem`: K and f from the user's forms and Dirichlet conditions. Rows and columns of
  prescribed unknowns in K are those of the identity, and f has the prescribed values there.
- `StiffnessSolver`: a KSP of PETSc that solves with K, counts its solves, and tells their error in
  the energy norm. `cholesky` makes one that factors K, `multigrid` one that iterates.
- `Component`: the displacement in a mixed space, whose other unknowns make K indefinite.
- `BodyFrames`: rigid motions with which linear bodies turn, so that K stays as it is.

| symbol | name in the code | meaning |
|---|---|---|
| K, f | `LinearSystem.K`, `.f` | stiffness matrix, load |
| u, w | `LinearSystem.displacement(w)`, w | displacement; all unknowns of a mixed space |
| M | `StiffnessSolver.preconditioner` | preconditioner; `uncertainty` bounds what r'M^-1 r misses |

Read first: `system.LinearSystem.assemble_stiffness`, `solver.StiffnessSolver.improve`,
`choice.SolverRequest.choose`.
"""
