"""Bodies that contact, or soft springs, hold: their rigid body modes, and loads in equilibrium."""
