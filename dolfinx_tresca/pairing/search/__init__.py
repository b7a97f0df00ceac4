"""Geometry of tagged surfaces: facets, nodes, weights, normals, search, clipping, visibility."""
