"""Bodies held by contact or soft springs: rigid body modes, and equilibrium of the loads."""
