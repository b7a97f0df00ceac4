"""Time series for ParaView: a `.pvd`, and in a folder beside it a folder of grids for each step."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from mpi4py import MPI

from dolfinx_tresca._base.atomic_write import file_named_in_errors
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.output.grid import ROOT, Grid
from dolfinx_tresca.output.vtu import DataSet, read_pvd, write_pvd, write_pvtu, write_vtu

#: Suffix of names of files and folders that are not complete.
INCOMPLETE = ".new"


@contextmanager
def writing(comm: MPI.Comm, path: Path) -> Iterator[None]:
    """Raise an error with the file's name on all ranks if any rank cannot write it. Collective.

    Raises:
        InputError: the block raised OSError; see `errors_on_all_ranks`.
    """
    with errors_on_all_ranks(comm), file_named_in_errors(path):
        yield


class Series:
    """Writes steps of named grids: files on the disk can be read at any time.

    Each rank writes its part of each grid of a step under a temporary name. When the step is
    complete, it is renamed, and a `.pvd` with this step replaces the old `.pvd`. The first step
    begins a new series: just before this step is renamed, the steps of an older series are removed,
    except the steps that `append` keeps.
    """

    def __init__(
        self, path: Path, *, append: bool = False, texts: Mapping[str, str] | None = None
    ) -> None:
        """Keep the path; nothing is read or written.

        Args:
            path: the `.pvd`, the same on all ranks.
            append: whether to keep the steps of an existing series that are before the first time
                that is written.
            texts: name -> content of further files in the folder.
        """
        self._path = path
        self._texts = {} if texts is None else texts
        self._folder = path.with_suffix("")
        self._append = append
        self._begun = False
        self._series: list[DataSet] = []  # filled on the first rank only

    def write(self, comm: MPI.Comm, grids: Mapping[str, Grid], time: float) -> None:
        """Add a step. Collective.

        Args:
            comm: communicator of the meshes.
            grids: name of the block -> this rank's part.
            time: time of the step, later than the last one.

        Raises:
            InputError: a file cannot be written, or the existing series cannot be continued.
        """
        first = comm.rank == ROOT
        cells = comm.gather({name: len(grid.cells) for name, grid in grids.items()}, root=ROOT)
        with writing(comm, self._path):
            step = self._begin(time) if first else None
        step = comm.bcast(step, root=ROOT)
        unfinished = step.with_name(step.name + INCOMPLETE)
        try:
            with writing(comm, self._path):
                for name, grid in grids.items():
                    if comm.size == 1:
                        write_vtu(unfinished / f"{name}.vtu", grid)
                    elif len(grid.cells):
                        write_vtu(unfinished / f"{name}_{comm.rank}.vtu", grid)
            with writing(comm, self._path):
                if cells is not None:
                    if comm.size > 1:
                        _write_pvtus(unfinished, grids, cells)
                    suffix = ".vtu" if comm.size == 1 else ".pvtu"
                    self._finish(unfinished, step, [f"{name}{suffix}" for name in grids], time)
        except Exception:  # raised on all ranks
            if first:
                _remove(unfinished)
                self._index.unlink(missing_ok=True)
            comm.barrier()
            raise

    @property
    def _index(self) -> Path:
        """The temporary name of the next `.pvd`."""
        return self._path.with_name(self._path.name + INCOMPLETE)

    def _begin(self, time: float) -> Path:
        """Return the folder of the step, and create its temporary folder. Not collective.

        Before the first step of a continued series, the index of older steps is read, and steps
        that are not before `time` are dropped.

        Raises:
            InputError: the older series cannot be read.
        """
        if self._append and not self._begun and self._path.exists():
            try:
                found = read_pvd(self._path)
                self._series = [data for data in found if data.time < time]
                last = max(self._numbers, default=-1)
            except ValueError as error:  # also if the name of a folder is not a number
                raise InputError(f"cannot add to '{self._path}': {error}.") from error
        else:
            last = max(self._numbers, default=-1)
        step = self._folder / f"{last + 1:04}"
        unfinished = step.with_name(step.name + INCOMPLETE)
        _remove(unfinished)
        unfinished.mkdir(parents=True)
        return step

    @property
    def _numbers(self) -> set[int]:
        """The numbers of the steps that the series has."""
        return {int(Path(data.file).parent.name) for data in self._series}

    def _finish(self, unfinished: Path, step: Path, files: list[str], time: float) -> None:
        """Rename the temporary folder `unfinished` to `step`, and add the step to the `.pvd`.

        At the first step, older steps that are not continued are removed. Not collective.
        """
        found = [
            DataSet(time, Path(file).stem, f"{self._folder.name}/{step.name}/{file}")
            for file in files
        ]
        write_pvd(self._index, [*self._series, *found])  # fails on a full disk, before renaming
        if not self._begun:
            for name, text in self._texts.items():
                (self._folder / name).write_text(text)
            self._forget_older(unfinished)
        unfinished.rename(step)
        self._index.replace(self._path)
        self._series += found
        self._begun = True

    def _forget_older(self, unfinished: Path) -> None:
        """Replace the `.pvd` by an index of the kept steps only, then remove all other steps."""
        if self._series:
            kept = self._index.with_suffix(".kept")
            write_pvd(kept, self._series)
            kept.replace(self._path)
        else:
            self._path.unlink(missing_ok=True)
        for folder in self._folder.glob("[0-9]*"):
            number = folder.name.removesuffix(INCOMPLETE)
            if number.isdecimal() and folder != unfinished and int(number) not in self._numbers:
                _remove(folder)


def _write_pvtus(
    folder: Path, grids: Mapping[str, Grid], cells: Sequence[Mapping[str, int]]
) -> None:
    """Write the `.pvtu` of each grid, with the files of the ranks that have cells.

    Not collective.
    """
    for name, grid in grids.items():
        pieces = [f"{name}_{rank}.vtu" for rank, mine in enumerate(cells) if mine[name]]
        write_pvtu(folder / f"{name}.pvtu", grid, pieces)


def _remove(folder: Path) -> None:
    """Remove the files of a step, and its folder if it is empty then. Not collective."""
    if not folder.is_dir():
        return
    for pattern in ("*.vtu", "*.pvtu"):
        for file in folder.glob(pattern):
            file.unlink(missing_ok=True)
    if not any(folder.iterdir()):
        folder.rmdir()
