"""Files that are there when they are complete, and only where there is room for them."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from mpi4py import MPI

from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.errors import InputError


@contextmanager
def named_in_errors(path: Path) -> Iterator[None]:
    """Name a file that the block cannot write. Not collective.

    Raises:
        InputError: the block raised OSError.
    """
    try:
        yield
    except OSError as error:
        raise InputError(
            f"cannot write '{path}': {error.strerror or error}. Choose another folder or name."
        ) from error


@contextmanager
def whole_files(path: Path, room: int = 0) -> Iterator[Path]:
    """Yield a path of the same name in a new folder beside it, for a block that writes there.

    At the end all that the block has left in that folder moves to the folder of `path`; after an
    exception nothing does. So a file there is a whole one, and the one of an earlier run is not
    lost to a run that fails. Not collective.

    Args:
        path: the file, or folder, that the block makes; it may make others beside it.
        room: what all of them take [bytes], at most. It is checked here, since libraries do not
            survive a full disk: VTK ends with a segmentation fault, HDF5 and ADIOS2 abort or hang.

    Raises:
        InputError: the files cannot be written there.
    """
    with named_in_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_file():
            path.open("r+b").close()  # one that is protected stays
        elif path.exists() and not path.is_dir():
            raise OSError("it is a device or a pipe, which a file would take the place of")
        with tempfile.TemporaryFile(dir=path.parent) as file:
            if room and hasattr(os, "posix_fallocate"):  # macOS has none
                os.posix_fallocate(file.fileno(), 0, room)
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
            yield Path(folder, path.name)
            for new in Path(folder).iterdir():
                old = path.with_name(new.name)
                if new.is_dir() and old.is_dir():
                    shutil.rmtree(old)
                new.replace(old)


@contextmanager
def whole_files_of_all(comm: MPI.Comm, path: Path, room: int) -> Iterator[Path]:
    """Do the same where all ranks write: the first one makes the folder and moves the files.

    Collective.

    Raises:
        InputError: the block raised OSError on all ranks; see `whole_files`.
    """
    with named_in_errors(path), ExitStack() as stack:
        new = path
        with errors_on_all_ranks(comm):
            if comm.rank == 0:
                new = stack.enter_context(whole_files(path, room))
        yield comm.bcast(new)
        comm.barrier()  # all have closed theirs
        with errors_on_all_ranks(comm):
            stack.close()
