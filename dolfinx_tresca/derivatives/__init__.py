"""Derivatives of solutions by controls, and the discretisation errors of goals.

A control is a Constant or a Function that users change in place. It acts on the *data* of a
solution (load, prescribed values, gaps and slip origins, radii of the friction discs); the data act
on the solution; a *goal*, such as a force, is a number computed from the solution. With each node
held in its contact state (open, stick, slip), both steps are linear. A *gradient* takes the
derivatives of a goal backwards, by the *adjoint*, to the data and then to all controls. The error
of a goal on this mesh is estimated with the same adjoint. A *tape* keeps accepted load steps, and
carries gradients back through them.

| symbol | name in the code | meaning |
|---|---|---|
| u, x | `LinearisedContact.u`, `.multipliers` | the solution |
| r | `LinearisedContact.gradient` | gradient (d; s) - B u of the dual energy |
| P, C | `LinearisedContact.face`, `.curvature` | projector on the face; curvature of the circles |
| z, y | `DataDerivatives.force`, `.offset` | adjoint: derivatives of a goal by load and offsets |
| q_u, q_x | `on_u`, `on_x` (and `on_jump` by B u) | derivatives of a goal by the solution |

Read first: `linearised.LinearisedContact` (the equations and the adjoint),
`data_of_solution.DataOfSolution` (what depends on controls), `gradient.gradient`. The files are in
the order of imports: `linearised`, `goals` (with their errors), `data_of_solution`, `gradient`,
`tape`; `dolfinx_tresca/pyadjoint.py` puts solves on the tape of pyadjoint.
"""
