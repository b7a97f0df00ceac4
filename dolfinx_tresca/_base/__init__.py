"""Tools of all rooms: arrays, MPI, PETSc, versions of DOLFINx; nothing of contact.

- `arrays`: types of arrays and matrices, rounding, vectors, plain numbers, random integers.
- `arguments`: checks of the numbers, vectors and words that users give.
- `tolerances`: how accurately inner problems are solved, and when an iteration is given up.
- `parallel`: an error of one rank on all ranks, the log, sums and exchanges that give the same bits
  on all ranks, observers, times.
- `agreement`: ranks compare the arguments of a `collective` function before its body runs.
- `petsc`: owners of PETSc objects, and matrices from rows.
- `compat`: the only file that knows that DOLFINx has versions; `requirements`: DOLFINx' import.
- `bodies`: the bodies of a mesh, numbered the same on any number of ranks, with names.
- `functions`: zero Functions, assembled forms, nodes at vertices.
- `atomic_write`: files that appear when they are complete.

Temporary vectors and matrices are not destroyed one by one: petsc4py frees them, on several ranks
in the next `petsc.free_unused` of their communicator. Make them from K or B (`createVecs`), not as
copies of a Function's `petsc_vec`, whose communicator is another one. Factorisations, and objects
that states keep, have an owner with `destroy()`.

Read first: `parallel.errors_on_all_ranks`, `agreement.collective`, `petsc.PetscOwner`.
"""
