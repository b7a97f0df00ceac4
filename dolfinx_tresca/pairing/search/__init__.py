"""Surfaces on this rank, and the search for facets that face each other.

- `tagged.py`: facets are taken from a mesh, with the vectors to their exact surfaces; `facets.py`:
  their shape functions, and their corners with weights and normals, an entry for each smooth patch.
- `pieces.py`: the straight `Pieces` into which curved facets are cut, and the search for those
  along normals; `halos` finds those of other ranks, too.
- `visibility.py`: overlaps of facets in a plane, the nearest of several layers, and what is hidden
  by a body; `self_contact.py`: on a surface that touches itself, which facets may meet, and which
  of two is secondary.

Read first: `facets.Facets`, `facets.SurfaceNodes`, `pieces.halos`.
"""
