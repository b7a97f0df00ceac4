"""Atomic writing of files: a file appears when it is complete."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dolfinx_tresca.errors import InputError


@contextmanager
def file_named_in_errors(path: Path) -> Iterator[None]:
    """Convert an OSError of the enclosed block to an InputError with the path. Not collective."""
    try:
        yield
    except OSError as error:
        raise InputError(
            f"cannot write '{path}': {error.strerror or error}. Choose another folder or name."
        ) from error


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield the path of a new file, which the block writes, and then move this file to `path`.

    Nothing is moved after an exception: a run that fails keeps an earlier file. Not collective.
    """
    with file_named_in_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_file():
            path.open("r+b").close()  # raises if the file is write-protected
        elif path.exists() and not path.is_dir():
            raise OSError("it is a device or a pipe, and a file would replace it")
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
            yield (new := Path(folder, path.name))
            new.replace(path)
