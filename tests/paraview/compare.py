"""Open the files of write.py in ParaView and compare: pvpython compare.py FOLDER."""

import json
import math
import sys
from pathlib import Path

from paraview import servermanager, simple
from vtkmodules.vtkFiltersVerdict import vtkCellSizeFilter

#: Of a field's largest number; files hold the numbers themselves.
ROUNDING = 1e-12

#: Of a length, area or volume: VTK breaks curved cells into straight ones.
STRAIGHT = 1e-3


def leaves(data, name=""):
    """Return name of the block -> its grid, of data of any depth."""
    if data.IsA("vtkDataSet"):
        return {name: data}
    found = {}
    for i in range(data.GetNumberOfBlocks()):
        own = data.GetMetaData(i).Get(data.NAME()) if data.HasMetaData(i) else None
        found.update(leaves(data.GetBlock(i), own or name))
    return found


def ranges(fields):
    """Return name -> least and largest value of each component."""
    arrays = [fields.GetArray(i) for i in range(fields.GetNumberOfArrays())]
    return {
        array.GetName(): [list(array.GetRange(i)) for i in range(array.GetNumberOfComponents())]
        for array in arrays
    }


def size_of(grid):
    """Return length, area or volume of all cells."""
    sizes = vtkCellSizeFilter()
    sizes.SetInputData(grid)
    sizes.Update()
    found = sizes.GetOutput().GetCellData()
    kind = {1: "Length", 2: "Area", 3: "Volume"}[grid.GetCell(0).GetCellDimension()]
    return sum(found.GetArray(kind).GetValue(i) for i in range(grid.GetNumberOfCells()))


def differences(found, wanted):
    """Return how two tables of ranges differ, for people."""
    if set(found) != set(wanted):
        return [f"fields {sorted(found)}, wanted {sorted(wanted)}"]
    faults = []
    for name, rows in wanted.items():
        size = max(abs(value) for row in rows for value in row)
        same = len(rows) == len(found[name]) and all(
            math.isclose(a, b, rel_tol=0.0, abs_tol=ROUNDING * size)
            for row, other in zip(rows, found[name], strict=True)
            for a, b in zip(row, other, strict=True)
        )
        if not same:
            faults.append(f"{name} is {found[name]}, wanted {rows}")
    return faults


def check(path, steps):
    """Return what is wrong with a file."""
    reader = simple.OpenDataFile(str(path))
    faults = []
    times = [time for time, _ in steps]
    known = list(getattr(reader, "TimestepValues", times))
    if path.suffix == ".pvd" and known != times:
        faults.append(f"times {known}, wanted {times}")
    for time, blocks in steps:
        reader.UpdatePipeline(time)
        grids = leaves(servermanager.Fetch(reader))
        if set(grids) != set(blocks):
            return [*faults, f"blocks {sorted(grids)}, wanted {sorted(blocks)}"]
        for name, wanted in blocks.items():
            grid = grids[name]
            if grid.GetNumberOfCells() != wanted["cells"]:
                faults.append(f"{grid.GetNumberOfCells()} cells, wanted {wanted['cells']}")
            if "size" in wanted and not math.isclose(
                size_of(grid), wanted["size"], rel_tol=STRAIGHT
            ):
                faults.append(f"size {size_of(grid)}, wanted {wanted['size']}")
            faults += differences(ranges(grid.GetPointData()), wanted["points"])
            faults += differences(ranges(grid.GetCellData()), wanted["values"])
            if "state" in wanted["points"]:
                if grid.GetPointData().GetArray("state").GetDataTypeAsString() != "int":
                    faults.append("state is no integer")
    if path.suffix == ".pvd":
        faults += check_look(reader, path)
    simple.Delete(reader)
    return faults


def check_look(reader, path):
    """Return what is wrong with what ParaView proposes, and with the colours of states."""
    faults = []
    view = simple.CreateView("RenderView")
    shown = simple.Show(reader, view)
    if list(shown.ColorArrayName) != ["POINTS", "displacement"]:
        faults.append(f"shows {list(shown.ColorArrayName)} at first")
    if list(simple.WarpByVector(reader).Vectors) != ["POINTS", "displacement"]:
        faults.append("warps by another vector than the displacement")
    colours = simple.GetColorTransferFunction("state")
    if not (colours.ApplyPreset("contact state", False) and colours.InterpretValuesAsCategories):
        faults.append("the colours of states are no categories")
    simple.Delete(view)
    return faults


def main(folder):
    """Compare all files."""
    faults, count = [], 0
    simple.ImportPresets(str(next(folder.glob("*/state.json"))))
    for table in sorted(folder.glob("*.json")):
        for file, steps in json.loads(table.read_text()).items():
            count += 1
            faults += [f"{file}: {fault}" for fault in check(folder / file, steps)]
    print(*faults, f"{count} files in ParaView {simple.GetParaViewVersion()}", sep="\n")
    return 1 if faults or not count else 0


sys.exit(main(Path(sys.argv[1])))
