"""Algorithms that minimise q = 1/2 lambda'A lambda - lambda'b over Lambda, (38.4).

Numbers such as (38.4) are those of Kucera et al. (2017), see docs/theory. The room imports neither
DOLFINx nor PETSc, only numpy and scipy: it can be read and tested with dense matrices.

The problem is given by protocols (`problem.py`): `DualProblem` for b, Lambda and the gradients at
multipliers, and `Compliance` for A, of which every product is counted. Arrays have the rows of one
rank; `Reductions` (`constraints.py`) adds them up. The page of the room `dual` follows one solve
from the user's call through these algorithms to the table.

- `ModelNewton`: the default method. A *model* M equals A where products are known; Newton's method
  solves the problem with M, and the step to its solution takes one product, which improves M.
  Coulomb's law runs in the same loop, without a fixed-point iteration around it: Newton's method
  follows the bounds, and the residual, which projects onto `section_at(x, r)`, vanishes only if
  the bounds are those of x itself. With this law, q need not decrease from step to step.
- `Iterate`: the present multipliers and their gradient, which is only as accurate as a step needs.
- `FeasibleSet` is Lambda for given slip bounds, `FrictionCones` where bounds depend on pressure or
  slip. The *section* of the cones at a point (`DualProblem.section_at`) is the Lambda of Tresca's
  law with the bounds at this point; for Coulomb's law, x minimises q over the section at its own
  pressures. `Face`: which multipliers are pressed, stick, slip at a point.
- `ProductStore`, `BlockBFGSModel`, `WholeModel`: known products, and the models made of them.
- `SemismoothNewton`: Newton's method for the problem with a model; its points are `NewtonPoint`s,
  and `NodalMaps` are the sparse matrices of its steps.
- `interior_point`: a further guess for Newton's method if A is known, by `SecondOrderCones`.
- `EqualityConstraints`, `balance`: equilibrium of floating bodies, and a start that satisfies it.
- `NaturalResidual`, `History` (`convergence.py`): the measure and the criteria of convergence.
- `paper.py`: the four algorithms of the paper.

| symbol | name in the code | meaning |
|---|---|---|
| lambda, x | `x` | multipliers |
| r | `Point.r`, `DualSolution.gradient` | A x - b - G c; `Iterate.r` is without G c |
| c | `c` | multipliers of the constraints |
| G, S, e | `EqualityConstraints.columns`, `.softness`, `.values` | G'x + S c = e |
| M | `model` | model of A |
| D, W, Y | `ProductStore.near` or a diagonal, `.W`, `.Y` | approximation of A; products Y = A W |
| P, rho | `FeasibleSet.project`, `rho` | projection; step length (`SemismoothNewton`: one a row) |
| kappa, C | `FeasibleSet.circle_stiffness` | curvature of friction circles: norm of r, over g |
| T, R | `NodalMaps.test`, `.added` | equations of a Newton step, with slopes Q, L of slip bounds |
| y, z, H | `SecondOrderCones` | tractions and slips in second-order cones, y = H x + h |

Read first: `iteration.solve`, `iteration.ModelNewton.run`,
`semismooth_newton.SemismoothNewton.solve`, `feasible_set.FeasibleSet`.
"""
