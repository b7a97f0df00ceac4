"""Output of problems and solutions: files for ParaView, pictures, and tables.

A `Grid` is one mesh with its fields in VTK's layout, gathered on the first rank (`gather_grid`):
the bodies, or the surface of a pair (`grids_of`). Files, pictures and `to_pyvista` are made of
grids. A `.pvd` lists the `.vtu` files of each step of a series, one for each grid.

A picture is a figure of matplotlib with a *panel* for the bodies and one for each pair. pyvista
renders the *views* of bodies and surfaces, matplotlib draws all text and the chart of a contact
curve of 2D. A `Contact` is a surface gathered for its panel.

A table is a list of `Row`s, names and values. A report is tables and the picture on one page.

Read first: `files.SolutionWriter`, `files.gather_grid`, `plot.compose`.
"""
