"""The dual problem of one solve: minimise q = 1/2 lambda'A lambda - lambda'b over Lambda, (38.4).

Numbers such as (38.4) are those of Kucera et al. (2017), see docs/theory. The jump operator B takes
displacements to jumps at contact nodes; A = B K^-1 B' takes tractions to jumps. This room makes B,
A, b and Lambda from pairs, K, load and laws, and bounds errors; the room `solvers` finds the
minimum. Rows of B have the roots of nodal areas as factors: inner products of multipliers are then
integrals. `stress_scale` and `length_scale` of B convert rows to stresses and lengths.

- `JumpOperator`: B with its scales, gaps and rows of each pair; `displaced_jump` pairs displaced
  surfaces anew, and `Carry` takes multipliers from one B to the next.
- `SlipBounds`: the user's laws at nodes, as `NodalBounds`, of which `JumpOperator.bounded` makes a
  `FeasibleSet`, or `FrictionCones` if any bound depends on the pressure.
- `friction_discs` stretches the rows of B such that friction ellipses are discs; `NodalValues`
  evaluates any field of the user at nodes.
- `ContactCompliance`: A for one B and one K, with products, near field, bound, error estimate.
- `SurfaceCompliance`: S, the exact part of K^-1 with A = B S B'; pairings with one K share it.
- `SlipHistory`: slip and dissipation of the accepted load steps.
- `EnergyBound`: a bound of the iteration's error; `DiscretisationError` estimates the mesh's.
- `DualProgram`: all of these together for one load, the input of `solvers`: b, and the displacement
  and the gradient that belong to multipliers.

| symbol | name in the code | meaning |
|---|---|---|
| N, T, B | `JumpOperator.matrix` | normal, tangential, all jumps |
| A | `ContactCompliance`, `compliance` | B K^-1 B' |
| b, d, s | `DualProgram.b`, `JumpOperator.gap`, `SlipHistory.origin` | b = B K^-1 f - (d; s) |
| lambda, x | `multipliers`, `x` | pressures and tangential tractions, scaled |
| r | `DualSolution.gradient` | (d; s) - B u = A x - b - G c: open gap, and minus the slip |
| Lambda, g | `DualProgram.section_at`, its `radius` | feasible set, slip bounds at a point |
| G, c | `EqualityConstraints.columns`, `c` | equilibrium of floating bodies, its multipliers |
| D, S | `NearField`; other D in `Lift`, exact S in `SurfaceCompliance` | about A, K^-1 nearby |

One solve, from the user's call to the table, with linear bodies. Once for all solves,
`ContactProblem(...)` makes the `LinearSystem`, pairs the surfaces (`pair_all_surfaces`) and makes B
of their N and T (`assemble_B`), finds the bodies that hardly anything holds (room `floating`), and
factors K with springs that hold them; A follows.

1. `ContactProblem.solve` collects options and observer. `ContactSystem.begin_solve` pairs anew the
   surfaces whose obstacles have moved, and returns to the state (`StepState`) of the start. With
   finite sliding, `solve_with_finite_sliding` follows, otherwise step 2.
2. `ContactSystem.solve` assembles f, evaluates slip bounds and gaps at the nodes, and makes the
   `DualProgram`, with `bounded` as `admissible`, and with u = K^-1 f, from which b follows.
3. `iteration.solve` (room `solvers`) chooses the method, by default `ModelNewton.run`. It begins at
   the multipliers of the state, or at zero if the residual is smaller there (not in a load step
   with bounds that depend on the pressure, as there may be several fixed points). If bodies float,
   `balance` moves the start into equilibrium.
4. Each iteration has two parts. `ModelNewton.target` calls `solve_model`, which solves the contact
   problem with a model M in place of A: `SemismoothNewton.solve` (`newton_solution`) takes steps
   that need no product with A, several times if M contains the near field, whose products improve
   M. The result is a `NewtonPoint`. Then `Iterate.move` takes the step to this point, with a single
   product with A, which gives the true gradient and improves M. With a direct solver, no product is
   needed if A is known as a matrix: from the start if this takes few solves with K, and later if
   the iteration is slow (`known_products` and `complete_products` of `ContactCompliance`); and
   only then `interior_point` helps Newton's method where it fails.
5. `ModelNewton.check_progress` ends the iteration. By `History.check_convergence` the status is
   CONVERGED, STOPPED or MAX_ITERATIONS; without progress it is STAGNATED or, if bounds depend on
   the pressure, NO_FIXED_POINT, with the motion that friction cannot hold, if there is one. The
   last iterate becomes the `DualSolution`.
6. `evaluate` (room `solution`) begins with `DualProgram.compute_displacement`: K u = f - B'x with
   the last x. `DualProgram.in_equilibrium` adds the rigid displacements of floating bodies. All
   fields, forces, energies and bounds are computed from this u and x.
7. `status_of_fields` compares the bound of the error of these fields with the accuracy that was
   asked for (missed: STAGNATED), and `ContactSystem.solve`, which called `evaluate`, returns a
   `ContactSolution`, whose status `ContactSystem.checked` changes if it has left linear theory.

If slip bounds depend on the pressure, errors are bounded as in Tresca's problem with the slip
bounds at x. Newton's method for nonlinear bodies and finite sliding repeat steps 2 to 7 without
`checked`, from the last multipliers; of the new A of a new K or B, no product is known. `accept`
(room `problem`) makes the tractions, slips and places of obstacles of a solution those from which
the next load step begins (`StepState.after_solution`).

Read first: `jump.JumpOperator.__init__`, `program.DualProgram`, `program.DualProgram.gradient`.
"""
