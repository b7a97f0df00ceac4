"""The file of a state, as the first rank reads it."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from zipfile import BadZipFile, is_zipfile

import numpy as np
import numpy.typing as npt

from dolfinx_tresca.errors import InputError

#: What files begin with; another number means another content.
FORMAT = "dolfinx_tresca state 2"

#: What all of them have.
NEEDED = {"laws", "keys", "points", "values", "numbers"}

#: Distance of a node from its place in the file, over the size of what it is on, that is rounding.
SAME_PLACE = 1e-9

#: The rank that reads and writes.
ROOT = 0


def read_file(path: Path) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays in a file by their names. Not collective.

    Raises:
        InputError: it cannot be read, or is no state.
    """
    try:
        with path.open("rb") as stream:
            if not is_zipfile(stream):  # numpy would propose to load it unsafely
                raise ValueError("it is no state, or its end is missing")
        with np.load(path, allow_pickle=False) as file:
            if "format" not in file.files:
                raise ValueError("it is no state")
            if str(file["format"]) != FORMAT:
                raise ValueError(f"its format is {file['format']}")
            return {name: file[name] for name in NEEDED.union(file.files)}
    except (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile) as error:
        raise InputError(
            f"cannot read a state from '{path}': {error}. Give the file that save_state() wrote."
        ) from error
