"""VTK's XML files: a grid (.vtu), the index of its pieces (.pvtu) or of a time series (.pvd)."""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ET
import zlib
from base64 import b64encode
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from dolfinx_tresca.output.grid import Grid

_TYPES = {"f8": "Float64", "f4": "Float32", "i8": "Int64", "i4": "Int32", "u1": "UInt8"}
_ORDER = {"little": "LittleEndian", "big": "BigEndian"}[sys.byteorder]


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
    for name, texts in grid.texts.items():
        _write_texts(ET.SubElement(whole, "FieldData"), name, texts)
    piece = ET.SubElement(
        whole,
        "Piece",
        NumberOfPoints=str(len(grid.points)),
        NumberOfCells=str(len(grid.cells)),
    )
    for parent, name, values in _arrays(grid):
        element = _array(_section(piece, parent, name), "DataArray", name, values)
        element.set("format", "binary")
        element.text = _encoded(values)
    ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def _write_texts(section: ET.Element, name: str, texts: Sequence[str]) -> None:
    """Add texts to a section of the XML, as bytes with a zero at the end of each text."""
    data = b"".join(text.encode() + b"\0" for text in texts)
    element = ET.SubElement(section, "DataArray", type="String", Name=name, format="ascii")
    element.set("NumberOfTuples", str(len(texts)))
    element.text = " ".join(map(str, data))


def _encoded(values: npt.NDArray[Any]) -> str:
    """Return one compressed block as text; ParaView 5.11 fails at raw bytes behind the XML."""
    data = values.tobytes()
    packed = zlib.compress(data, level=1)
    sizes = np.array([1, len(data), 0, len(packed)], dtype=np.uint64)
    return (b64encode(sizes.tobytes()) + b64encode(packed)).decode()


def write_pvtu(path: Path, grid: Grid, pieces: Sequence[str]) -> None:
    """Write a .pvtu file: the index of the pieces of a grid. Not collective.

    Args:
        path: path of the file.
        grid: one of the pieces; all have the same fields.
        pieces: names of the files of the pieces, in the same folder.

    Raises:
        OSError: the file cannot be written.
    """
    root = _root("PUnstructuredGrid")
    whole = ET.SubElement(root, "PUnstructuredGrid", GhostLevel="0")
    for parent, name, values in _arrays(grid):
        if parent != "Cells":
            _array(_section(whole, f"P{parent}", name), "PDataArray", name, values)
    for piece in pieces:
        ET.SubElement(whole, "Piece", Source=piece)
    _save(path, root)


def write_pvd(path: Path, series: Sequence[DataSet]) -> None:
    """Write the index of a time series. Not collective.

    Raises:
        OSError: the file cannot be written.
    """
    root = _root("Collection")
    collection = ET.SubElement(root, "Collection")
    parts = list(dict.fromkeys(data.name for data in series))
    for time, name, file in series:
        part = str(parts.index(name))
        ET.SubElement(collection, "DataSet", timestep=repr(time), part=part, name=name, file=file)
    _save(path, root)


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
    header = {"version": version, "byte_order": _ORDER, "header_type": "UInt64"}
    return ET.Element("VTKFile", {"type": kind, **header})


def _arrays(grid: Grid) -> Iterator[tuple[str, str, npt.NDArray[Any]]]:
    """Yield, for each array of a grid, the name of its section, its own name and its values."""
    nodes = grid.cells[:, 1:]
    for name, values in grid.values.items():
        yield "PointData", name, values
    for name, values in grid.cell_values.items():
        yield "CellData", name, values
    yield "Points", "Points", grid.points
    yield "Cells", "connectivity", nodes
    yield "Cells", "offsets", nodes.shape[1] * np.arange(1, len(nodes) + 1, dtype=np.int64)
    yield "Cells", "types", grid.cell_types.astype(np.uint8)


def _section(parent: ET.Element, name: str, first: str) -> ET.Element:
    """Return the section `name` of an element; the first call creates the section.

    In a new section of point data the array `first` is active: ParaView initially colours by it,
    warps by it, and draws it as arrows.
    """
    found = parent.find(name)
    if found is not None:
        return found
    active = {"Scalars": first, "Vectors": first} if name.endswith("PointData") else {}
    return ET.SubElement(parent, name, active)


def _array(section: ET.Element, tag: str, name: str, values: npt.NDArray[Any]) -> ET.Element:
    columns = values.shape[1] if values.ndim == 2 and section.tag != "Cells" else 1
    return ET.SubElement(
        section,
        tag,
        type=_TYPES[values.dtype.str[1:]],
        Name=name,
        NumberOfComponents=str(columns),
    )


def _save(path: Path, root: ET.Element) -> None:
    ET.indent(root)
    ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
