"""Objects that users give: meshes with tags, pairs of surfaces, laws, obstacles, goals.

Types and shapes are checked when an object of this room is made. It keeps references to the
Constants and Functions in it, which users change in place before a solve: values of slip bounds and
gaps are checked at the nodes, by rooms above. Nothing here is computed on nodes.

- `ContactPair`: two surfaces, given by tags, with a law; the primary side may be a `RigidObstacle`.
- A *law* is `Frictionless`, `Bonded`, or a `DryFriction` with the *terms* of its slip bound
  c + min(F p, l) under the pressure p (`BoundTerms`): `Tresca(g)` has c = g alone, `Coulomb(F)` has
  F, and may have an adhesion c and a limit l. F may be a `FrictionCurve`, a function of pressure
  and slip.
- A *scalar field* is what a bound or a gap may be: a number, Constant, Function, expression, or a
  function of points.
- `RigidMotion`: where an obstacle is, x -> R x + t from where it was made.
- `NamedTags`, `MergedTags`: tags with their names; lists of tags with one number.
- `GmshGeometry`: the curved surfaces that facets approximate.
- A *goal* is a number computed from a solution, such as `NormalForce`.

| symbol | name in the code | meaning |
|---|---|---|
| c, F, l | `BoundTerms.constant`, `.coefficient`, `.limit` | terms of the slip bound |
| p, v | arguments of `FrictionCurve.values` | pressure, slip of the step |
| R, t | `RigidMotion.rotation`, `.translation` | motion of an obstacle |

Read first: `pair.ContactPair`, `friction.BoundTerms`, `obstacle.RigidObstacle.at`.
"""
