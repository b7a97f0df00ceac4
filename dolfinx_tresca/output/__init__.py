"""What is shown of problems and solutions: files for ParaView, pictures, and tables."""
