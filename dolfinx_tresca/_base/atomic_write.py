"""Atomic writing of files: a file appears when it is complete."""

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
def file_named_in_errors(path: Path) -> Iterator[None]:
    """Convert an OSError of the enclosed block to an InputError with the path. Not collective.

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
def atomic_write(path: Path, room: int = 0) -> Iterator[Path]:
    """Yield a temporary path to write to; after the block, move the written files to `path`.

    The temporary path has the same name, in a new folder beside `path`. At the end of the block,
    all files in the new folder are moved to the folder of `path`; after an exception, no file is
    moved. So files are always complete, and a run that fails keeps the files of earlier runs. Not
    collective.

    Args:
        path: the file or folder that the block writes; the block may write further files beside
            the temporary path.
        room: upper bound of the size of all files together [bytes]; 0: unknown. So much free space
            must exist before the block, since libraries crash on a full disk: VTK ends with a
            segmentation fault; HDF5 and ADIOS2 abort or hang.

    Raises:
        InputError: files cannot be written to the folder of `path`.
    """
    with file_named_in_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_file():
            path.open("r+b").close()  # raises if the file is write-protected
        elif path.exists() and not path.is_dir():
            raise OSError("it is a device or a pipe, and a file would replace it")
        with tempfile.TemporaryFile(dir=path.parent) as file:
            if room and hasattr(os, "posix_fallocate"):  # not on macOS
                os.posix_fallocate(file.fileno(), 0, room)
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
            yield Path(folder, path.name)
            for new in Path(folder).iterdir():
                old = path.with_name(new.name)
                if new.is_dir() and old.is_dir():
                    shutil.rmtree(old)
                new.replace(old)


@contextmanager
def atomic_write_on_all_ranks(comm: MPI.Comm, path: Path, room: int) -> Iterator[Path]:
    """Yield the temporary path of `atomic_write` on all ranks, which write to it together.

    The first rank makes the folder and moves the files. Collective.

    Raises:
        InputError: the block raised OSError on all ranks, or `atomic_write` failed.
    """
    with file_named_in_errors(path), ExitStack() as stack:
        new = path
        with errors_on_all_ranks(comm):
            if comm.rank == 0:
                new = stack.enter_context(atomic_write(path, room))
        yield comm.bcast(new)
        comm.barrier()  # all ranks have closed their files
        with errors_on_all_ranks(comm):
            stack.close()
