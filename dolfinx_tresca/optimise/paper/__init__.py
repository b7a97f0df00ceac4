"""The algorithms of the paper: SSN, MSSN, IMSSN and GIMSSN, with sweeps for Coulomb's law."""
