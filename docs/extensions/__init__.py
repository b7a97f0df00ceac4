"""What the site has beside Sphinx: demos as pages, kept measurements, docstrings, links."""
