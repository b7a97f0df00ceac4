"""The user's input: pairs of surfaces, laws of friction, rigid obstacles, and tagged meshes."""
