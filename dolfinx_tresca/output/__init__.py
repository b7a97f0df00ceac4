"""Output of problems and solutions: files for ParaView, pictures, and tables."""
