"""The results of a solve: displacement, fields on the surfaces, energies, forces, counts, warnings.

- `evaluate` makes an `Evaluation` from multipliers: first the nodes of all pairs, then the surface
  of each pair. `ContactSolution` (`result.py`) adds how the solve went; `status_of_fields` compares
  the accuracy of the fields with what the user asked for.
- `Surface`: the mesh of a secondary side; `SurfaceFields`: the Functions on it.
- `Resultant`: force and moment, of contact on a pair or body, or of a support: `Supports`.
- `scene_checks`: hints at likely mistakes, and the *departures* of a solution from linear theory.
- `slip_from`: slips of a solution at the nodes of another mesh.

| symbol | name in the code | meaning |
|---|---|---|
| lambda_nu, lambda_tau | `pressure`, `traction` | positive in compression; along the slip |
| d - N u, T u - s | `gap`, `slip_increment` | open gap; slip of the step |
| J(u), D(lambda) | `primal_energy`, `dual_energy` | equal at the exact solution |

Read first: `evaluation.evaluate`, `fields.Surface.fields`, `forces.resultants_on`.
"""
