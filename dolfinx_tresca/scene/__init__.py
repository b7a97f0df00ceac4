"""Objects that users give: meshes with tags, pairs of surfaces, laws, obstacles, goals.

Types and shapes are checked when an object of this room is made. The object keeps references to
the user's Constants and Functions, whose values may change before each solve. So slip bounds and
gaps are not evaluated here: rooms above evaluate and check them at the nodes.

- `ContactPair`: two surfaces, given by tags, with a law; the primary side may be a `RigidObstacle`.
- A *law* is `Frictionless`, `Bonded`, `Preload`, or a `DryFriction` with *terms* of its slip bound
  c + min(F p, l) under the pressure p (`BoundTerms`): `Tresca(g)` has c = g alone, `Coulomb(F)` has
  F, and may have an adhesion c and a limit l. F may be a `FrictionCurve`, a function of pressure
  and slip.
- A *scalar field* is what a bound or a gap may be: a number, Constant, Function, expression, or a
  function of points.
- `RigidMotion`: x -> R x + t from the place where an obstacle was made to its present place.
- `NamedTags`, `MergedTags`: tags with their names; tags in which each list of tags is one tag.
- `GmshGeometry`: the curved surfaces that facets approximate.
- A *goal* is a number computed from a solution, such as `NormalForce`.

| symbol | name in the code | meaning |
|---|---|---|
| c, F, l | `BoundTerms.constant`, `.coefficient`, `.limit` | terms of the slip bound |
| p, v | arguments of `FrictionCurve.values` | pressure, slip of the step |
| R, t | `RigidMotion.rotation`, `.translation` | motion of an obstacle |

Read first: `pair.ContactPair`, `friction.BoundTerms`, `obstacle.RigidObstacle.at`.
"""
