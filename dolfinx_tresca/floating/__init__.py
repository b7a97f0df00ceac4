"""Bodies held by contact or soft springs: rigid body modes, and equilibrium of the loads.

K is singular, or nearly so, for a body that no support holds. Springs fix such bodies while K is
factored, and their effect is removed again: forces on each body must balance. This is an equation
of the contact multipliers, whose own multipliers c are the rigid displacements.

- `RigidBodyModes`: the modes of `Bodies` that supports and K resist weakly or not at all.
- `FixingSprings`: springs that are in the factored K_p, not in K, and the response to them.
- `HeldStiffness`: K with these springs, assembled and factored anew when K has changed.
- `FloatingBodies`, `Equilibrium`: the equations G'lambda + S c = e, and the motions they leave.
- `Tools`, `FreeMotion`: obstacles held by forces, and bolts, which join these equations.

| symbol | name in the code | meaning |
|---|---|---|
| R | `RigidBodyModes.basis` | rigid body modes |
| K_p | `FixingSprings.added_to(K)` | K with springs |
| U, c | `FloatingBodies.displacements`, `c` | responses to springs; coefficients, scaled |
| G, S, e | `EqualityConstraints`, in `solvers` | B U, stiffness of K against U, resultants U'f |

Read first: `rigid_modes.weakly_resisted_modes`, `FixingSprings`, `equilibrium.Equilibrium`.
"""
