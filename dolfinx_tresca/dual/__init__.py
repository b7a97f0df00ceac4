"""The dual problem of one solve: minimise q = 1/2 lambda'A lambda - lambda'b over Lambda, (38.4).

The jump operator B takes displacements to jumps at contact nodes; A = B K^-1 B' takes tractions to
jumps. This room makes B, A, b and Lambda from pairs, K, load and laws, and bounds errors; the room
`solvers` finds the minimum. Rows of B are scaled by the roots of the nodes' areas, so that sums of
multipliers are integrals; physical values are *stresses* and *lengths*.

- `JumpOperator`: B with its scales, gaps and rows of each pair; `moved_jump` pairs displaced
  surfaces anew, and `Carry` takes multipliers from one B to the next.
- `SlipBounds`: the user's laws at nodes, as `NodalBounds`, of which `JumpOperator.bounded` makes a
  `FeasibleSet`, or `FrictionCones` if any bound depends on the pressure.
- `friction_discs` stretches the rows of B such that friction ellipses are discs; `NodalValues`
  evaluates any field of the user at nodes.
- `ContactCompliance`: all that follows from one K: A, near field, bound, error estimate.
- `SlipHistory`: slip and dissipation of the accepted load steps.
- `EnergyBound`: a bound of the iteration's error; `DiscretisationError` estimates the mesh's.
- `DualProgram`: all of these together for one load, the input of `solvers`: b, and the displacement
  and the gradient that belong to multipliers.

| symbol | name in the code | meaning |
|---|---|---|
| N, T, B | `JumpOperator.matrix` | normal, tangential, all jumps |
| A | `ContactCompliance`, `compliance` | B K^-1 B' |
| b, d, s | `DualProgram.b`, `JumpOperator.gap`, `SlipHistory.origin` | as in (38.4) |
| lambda, x | `multipliers`, `x` | pressures and tangential tractions, scaled |
| r | `gradient` | (d; s) - B u = A x - b - G c: open gap, and minus the slip |
| Lambda, g | `DualProgram.admissible`, `FeasibleSet.radius` | feasible set, slip bounds |
| G, c | `EqualityConstraints.columns`, `c` | equilibrium of floating bodies, its multipliers |
| D, S | `NearField`, D also diag(K)^-1 in `Lift` | local approximations |

Read first: `jump.JumpOperator.__init__`, `program.DualProgram`, `program.DualProgram.gradient`.
"""
