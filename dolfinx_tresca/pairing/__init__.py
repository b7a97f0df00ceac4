"""Which points of two surfaces meet: their normals, gaps, and the jump operators N and T.

Facets with tags become surfaces; secondary facets seek primary ones along their normals; mortar
integrals over the overlap give the jump of the displacement at the secondary nodes, in the dual
basis. A rigid obstacle has no facets: its signed distance takes the place of the primary surface.

Nouns:

- `PairGroup`: pairs whose sides are parts of the same surfaces, so that a node has one multiplier.
- `Undeformed`: the group with the facets of both sides, which are displaced for each later pairing.
- `Facets`, `SurfaceNodes`: a surface on this rank with the shape functions of its facets, and its
  corners, which may carry multipliers, with an entry for each smooth patch (`facets.py`).
- `Pieces`: the straight pieces into which curved facets are cut, and the search for pieces along
  normals; `halos` copies the facets of other ranks that this rank needs (`pieces.py`).
- `Visibility`, `SelfContact`: which points a body hides; on a surface that touches itself, which
  facets may meet, and which of two is secondary (`visibility.py`).
- `SmoothSurface`: the surface that facets approximate; the contact normal follows from the angles
  by which the normals of both sides turn (`contact_normal.py`, which derives the rule).
- `FacetIntegrals`: integrals over the parts of facets that face the other side: `MortarIntegrals`
  over the overlap of both surfaces, `obstacle_integrals` over facets that face an obstacle.
- `PairOperators`: N, T, gaps and areas at the nodes of a pair that carry multipliers
  (`operators.py`); `couple` computes them. `ContactOperators` shows them to users, and transfers
  fields and loads between the sides.

Symbols: the hat functions phi are `hats`, the dual basis psi is `dual`, the projection P from the
primary side is `PairOperators.primary`, the covered areas w are `weights`. The jump is secondary
minus primary, along normals out of the secondary side: N u > 0 closes, gap - N u of a gap remains.

All that is computed here follows from the positions of nodes: the only state is `Undeformed`, which
`PairOperators` carries from one pairing to the next and which is never changed.

Read first: `pair_surfaces.pair_all_surfaces`, `facets.Facets`, `coupling.couple`,
`mortar_integrals.MortarIntegrals`.
"""
