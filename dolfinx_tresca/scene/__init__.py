"""What users say: pairs of surfaces, laws of friction, rigid obstacles, and meshes with tags."""
