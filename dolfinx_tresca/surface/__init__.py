"""Geometry of tagged surfaces: nodes, weights, normals, tangents."""
