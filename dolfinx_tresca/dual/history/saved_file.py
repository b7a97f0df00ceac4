"""The contents of the file of a state, and the function that reads it on the first rank."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, is_zipfile

import numpy as np
import numpy.typing as npt

from dolfinx_tresca.errors import InputError

#: Name and version of the format of the file.
FORMAT = "dolfinx_tresca state 4"

#: Names of the arrays that every file has.
NEEDED = {"laws", "keys", "points", "values", "numbers", "motions"}

#: Name of the array with the `surroundings` of the nodes, which locate the rows of displacements.
SURROUNDINGS = "surroundings"

#: Prefixes of the names of arrays that come with positions of their own: arrays of the material's
#: history, and of those unknowns of a mixed space that are not displacements.
MATERIAL, UNKNOWN = "material ", "unknown "

#: A node and a position in the file count as the same if their distance is at most this fraction of
#: the extent of all nodes.
SAME_PLACE = 1e-9

#: The rank that reads and writes files.
ROOT = 0


def read_file(path: Path) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays in a file by their names. Not collective.

    Raises:
        InputError: the file cannot be read, or holds no state.
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
            content = {name: file[name] for name in NEEDED.union(file.files)}
        _check(content)
    except (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile) as error:
        raise InputError(
            f"cannot read a state from '{path}': {error}. Give the file that save_state() wrote."
        ) from error
    return content


def _check(content: Mapping[str, npt.NDArray[Any]]) -> None:
    """Check for contents that `save_state` never writes. Not collective.

    Raises:
        ValueError: values are not finite, or some values are missing.
    """
    for name, values in content.items():
        if values.dtype.kind not in "fiuU":
            raise ValueError(f"'{name}' has values of type {values.dtype}")
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            raise ValueError(f"'{name}' has values that are NaN or infinite")
    others = content.keys() - NEEDED - {"format"}
    material = {name for name in others if name.startswith((MATERIAL, UNKNOWN))}
    groups: list[tuple[str, ...]] = [("keys", "points", "values"), tuple(others - material)]
    for name in sorted(material):
        if not name.endswith(" at"):
            groups.append((name, f"{name} at"))
    for together in groups:
        if len({len(content[name]) for name in together}) > 1:
            raise ValueError(f"{', '.join(sorted(together))} must have as many rows each")
    if content["numbers"].shape != (3,):
        raise ValueError(f"'numbers' has shape {content['numbers'].shape} and not (3,)")
    if content["motions"].shape != (len(content["laws"]), 3, 4):
        raise ValueError(f"'motions' has shape {content['motions'].shape}")
