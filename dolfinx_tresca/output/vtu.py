"""VTK's XML files: a grid (.vtu), the index of its pieces (.pvtu) or of a time series (.pvd)."""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ET
import zlib
from base64 import b64encode
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from dolfinx_tresca.output.grid import Grid

_TYPES = {"f8": "Float64", "f4": "Float32", "i8": "Int64", "i4": "Int32", "u1": "UInt8"}
_BYTE_ORDER = {"little": "LittleEndian", "big": "BigEndian"}[sys.byteorder]


class DataSet(NamedTuple):
    """A line of a `.pvd`: one block at one time.

    Attributes:
        time: time in any unit.
        name: name of the block.
        file: path of the `.vtu` or `.pvtu`, from the folder of the `.pvd`.
    """

    time: float
    name: str
    file: str


def write_vtu(path: Path, grid: Grid) -> None:
    """Write a grid. Not collective.

    Raises:
        OSError: the file cannot be written.
    """
    # in files of a version below 2.2, readers reorder the nodes of hexahedra of degree 2
    root = _root("UnstructuredGrid", "2.2" if grid.degree > 1 else "1.0")
    root.set("compressor", "vtkZLibDataCompressor")
    whole = ET.SubElement(root, "UnstructuredGrid")
    for name, texts in grid.texts.items():  # as bytes, with a zero at the end of each text
        field_data = ET.SubElement(whole, "FieldData")
        array = ET.SubElement(field_data, "DataArray", type="String", Name=name, format="ascii")
        array.set("NumberOfTuples", str(len(texts)))
        array.text = " ".join(map(str, b"".join(text.encode() + b"\0" for text in texts)))
    sizes = {"NumberOfPoints": str(len(grid.points)), "NumberOfCells": str(len(grid.cells))}
    piece = ET.SubElement(whole, "Piece", sizes)
    nodes = grid.cells[:, 1:]
    cells: dict[str, npt.NDArray[Any]] = {
        "connectivity": nodes.ravel(),
        "offsets": nodes.shape[1] * np.arange(1, len(nodes) + 1, dtype=np.int64),
        "types": grid.cell_types.astype(np.uint8),
    }
    for section, arrays in {**_fields(grid), "Cells": cells}.items():
        element = _section(piece, section, arrays)
        for name, values in arrays.items():
            array = _declared(element, "DataArray", name, values)
            array.set("format", "binary")
            array.text = _compressed(values)
    ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def write_pvtu(path: Path, grid: Grid, pieces: Sequence[str]) -> None:
    """Write the index of the pieces of a grid. Not collective.

    Args:
        path: path of the file.
        grid: one of the pieces; all have the same fields.
        pieces: names of the files of the pieces, in the same folder.

    Raises:
        OSError: the file cannot be written.
    """
    root = _root("PUnstructuredGrid")
    whole = ET.SubElement(root, "PUnstructuredGrid", GhostLevel="0")
    for section, arrays in _fields(grid).items():
        element = _section(whole, f"P{section}", arrays)
        for name, values in arrays.items():
            _declared(element, "PDataArray", name, values)
    for piece in pieces:
        ET.SubElement(whole, "Piece", Source=piece)
    ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def write_pvd(path: Path, series: Sequence[DataSet]) -> None:
    """Write the index of a time series. Not collective.

    Raises:
        OSError: the file cannot be written.
    """
    root = _root("Collection")
    collection = ET.SubElement(root, "Collection")
    names = list(dict.fromkeys(data.name for data in series))
    for time, name, file in series:
        number = str(names.index(name))
        ET.SubElement(collection, "DataSet", timestep=repr(time), part=number, name=name, file=file)
    ET.indent(root)
    ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def read_pvd(path: Path) -> list[DataSet]:
    """Return the entries of a file that `write_pvd` has written. Not collective.

    Raises:
        OSError: the file cannot be read.
        ValueError: the file is no such series.
    """
    try:
        return [
            DataSet(float(item.attrib["timestep"]), item.attrib["name"], item.attrib["file"])
            for item in ET.parse(path).iter("DataSet")
        ]
    except (ET.ParseError, KeyError) as error:
        raise ValueError(f"not a series of ours ({error!r})") from error


def _root(kind: str, version: str = "1.0") -> ET.Element:
    header = {"version": version, "byte_order": _BYTE_ORDER, "header_type": "UInt64"}
    return ET.Element("VTKFile", {"type": kind, **header})


def _fields(grid: Grid) -> dict[str, dict[str, npt.NDArray[Any]]]:
    """Return the arrays of each section that `.vtu` and `.pvtu` have."""
    return {
        "PointData": grid.values,
        "CellData": grid.cell_values,
        "Points": {"Points": grid.points},
    }


def _section(parent: ET.Element, name: str, arrays: dict[str, Any]) -> ET.Element:
    """Return a new section. The first array of point data is active.

    ParaView initially colours by this array, warps by it, and draws it as arrows.
    """
    element = ET.SubElement(parent, name)
    if name.endswith("PointData"):
        active = next(iter(arrays))
        element.attrib.update(Scalars=active, Vectors=active)
    return element


def _declared(section: ET.Element, tag: str, name: str, values: npt.NDArray[Any]) -> ET.Element:
    """Return a new array without values, with its name, type and number of components."""
    components = str(values.shape[1] if values.ndim == 2 else 1)
    kind = _TYPES[values.dtype.str[1:]]
    return ET.SubElement(section, tag, type=kind, Name=name, NumberOfComponents=components)


def _compressed(values: npt.NDArray[Any]) -> str:
    """Return one compressed block as text; ParaView 5.11 fails at raw bytes behind the XML."""
    data = values.tobytes()
    packed = zlib.compress(data, level=1)
    sizes = np.array([1, len(data), 0, len(packed)], dtype=np.uint64)
    return (b64encode(sizes.tobytes()) + b64encode(packed)).decode()
