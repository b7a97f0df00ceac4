"""Derivatives of solutions by controls, and the discretisation errors of goals.

A control is a Constant or a Function that users change in place. It acts on the *data* of a
solution (load, prescribed values, gaps and slip origins, radii of the friction discs); the data act
on the solution; a *goal*, such as a force, is a number computed from the solution. Derivatives hold
each node in its contact state (open, stick, slip). A *tangent* takes a change of controls forwards,
to the change of the data, of the solution and of all goals. A *gradient* takes the derivatives of
one goal backwards, by the *adjoint*, to all controls. The error of a goal on this mesh is estimated
with an adjoint, too. A *tape* keeps accepted load steps, and carries gradients back through them.

| symbol | name in the code | meaning |
|---|---|---|
| u, x | `LinearisedContact.u`, `.multipliers` | the solution |
| r | `LinearisedContact.gradient` | gradient (d; s) - B u of the dual energy |
| P, C | `LinearisedContact.face`, `_states` | projector on the face; curvature of the circles |
| df, du_D; do, dg | `DataVector.load`; `.laws` | change of load, u_D; of offsets (d; s), radii |
| z, y | `DataVector.load`, `.laws` | adjoint: derivatives of a goal by load and offsets |
| q_u, q_x | `by_u`, `by_x` (and `by_jump` by B u) | derivatives of a goal by the solution |

Read first: `linearised.LinearisedContact` (the equations, with tangent and adjoint as one solve),
`change_of_data.DataOfSolution` (what depends on controls), `goals.gradient`. The files are in the
order of imports: `linearised`, `change_of_data`, `goals` (errors, gradients, tangents), `tape`.
"""
