"""The default method: projected Newton on a model of A, also for Coulomb's law."""
