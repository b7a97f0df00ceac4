"""Tables and the picture of benchmarks/tradeoff.py."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from harness import Column, Row, Table
from harness.figure import new_figure, percent_ticks, plain_ticks, save

#: Kind of error -> its name in tables.
ERRORS = {
    "energy": "energy",
    "pressure": "pressure in L2",
    "peak": "peak pressure",
    "force": "contact force",
    "slip": "slip in L2",
}
TARGETS = (0.1, 0.05, 0.02, 0.01, 0.001)

#: Largest error that counts as rounding, such as the error of a force that statics determine.
EXACT = 1e-9

#: Largest ratio of an error to another error that counts as an improvement.
GAIN = 0.97


def described(row: Row) -> str:
    """Return the settings of a row, without defaults, as text."""
    kind = "" if row["method"] == "projected_newton" else f"{row['method']}, "
    kind += "" if row["pairing"] == "auto" else f"{row['pairing']}, "
    kind += "" if row["fraction"] == 0.5 else f"fraction {row['fraction']:g}, "
    return kind + row["asked"] + ("" if row["krylov"] is None else f", K {row['krylov']:g}")


COLUMNS = [
    Column("scene", "{scene}", width=10),
    Column("mesh", "{family}", width=9),
    Column("size", "{size:g}", width=5),
    Column("n/m", "{n}/{m}", width=12),
    Column("axis", "{axis}", width=9),
    Column("K-solver", "{chosen}", width=9),
    Column("method, requested", lambda rows: described(rows[0]), width=22),
    Column("seconds", "{seconds:.2f}"),
    Column("wall", "{wall:.2f}"),
    Column("asked", "{accuracy:g}", width=6),
    Column("MB", "{memory_mb:.0f}", width=6),
    Column("iter/n_A", "{iterations}/{products}"),
    *(Column(error, f"{{{error}:.1e}}", width=8) for error in ERRORS),
    Column("mesh", "{mesh_error:.1e}", width=8),
    Column("algebra", "{algebra_error:.1e}", width=8),
    Column("bound", "{energy_error_bound:.1e}", width=8),
    Column("estimate", "{discretisation_error:.1e}"),
    Column("effect.", "{effectivity:.2f}"),
]


def front(rows: list[Row], error: str, cost: str) -> list[Row]:
    """Return the Pareto front of error and cost, by ascending cost, without tiny gains (`GAIN`)."""
    result: list[Row] = []
    for row in sorted(rows, key=lambda row: (row[cost], row[error])):
        if not result or row[error] < GAIN * result[-1][error]:
            result.append(row)
    return result


def converged(rows: list[Row], scene: str, error: str = "energy") -> list[Row]:
    """Return the converged rows of a scene with this error; references only for "energy"."""
    return [
        row
        for row in rows
        if row["scene"] == scene and row.get("status") == "CONVERGED" and error in row
        if row["axis"] != "reference" or error == "energy"
    ]


def over_mesh(rows: list[Row]) -> Iterator[Row]:
    """Yield the rows of axes "part" and "rtol", with errors divided by those of the best run.

    The best run has the least algebraic error on the same mesh and with the same K-solver.
    """
    own = [row for row in rows if row["axis"] in ("part", "rtol")]
    same_mesh = ("scene", "family", "size", "chosen")
    for row in own:
        runs = [r for r in own if all(r[name] == row[name] for name in same_mesh)]
        best = min(runs, key=lambda r: r["algebra_error"])
        least = min(r["seconds"] for r in runs)
        ratios = {error: row[error] / best[error] for error in ERRORS if error in best}
        more = {"algebra": row["algebra_error"] / row["mesh_error"]}
        yield {**row, **ratios, **more, "seconds_over_least": row["seconds"] / least}


def part_lines(rows: list[Row], scene: str) -> Iterator[str]:
    """Yield lines with the cost and the errors for each requested part of the mesh's error."""
    found = list(over_mesh(converged(rows, scene)))
    for key in dict.fromkeys((row["family"], row["size"], row["chosen"]) for row in found):
        yield f"\n{scene}, {key[0]} of size {key[1]:g}, {key[2]}: errors over the mesh's own"
        names = ("algebra", *(error for error in ERRORS if error in found[0]))
        yield f"{'requested':<12} {'products':>8} {'seconds':>8} " + " ".join(
            f"{name:>9}" for name in names
        )
        for row in found:
            if (row["family"], row["size"], row["chosen"]) == key:
                parts = " ".join(f"{row[name]:>9.3f}" for name in names)
                time = f"{row['seconds_over_least']:>7.2f}x"
                yield f"{row['asked']:<12} {row['products']:>8} {time} {parts}"


def name_of(row: Row) -> str:
    """Return the mesh and the settings of a row as a short text."""
    size = f"h = {row['size']:g} mm" if row["scene"] == "hertz" else f"N = {row['size']:g}"
    if row["accuracy"]:
        size = f"accuracy={row['accuracy']:g}"
    how = described(row)
    if row["axis"] == "backend":
        how = row["stiffness"]
    return f"{row['family']}, {size}" + ("" if how == "default" else f", {how}")


def front_lines(rows: list[Row], scene: str) -> Iterator[str]:
    """Yield the lines of a scene's Pareto fronts."""
    for error in ERRORS:
        own = converged(rows, scene, error)
        for cost, unit in (("seconds", "s"), ("memory_mb", "MB")):
            if own:
                yield f"\n{scene}, Pareto front: {error} over {cost}"
            for row in front(own, error, cost):
                yield f"  {row[error]:8.1e} {row[cost]:9.2f} {unit:<2}  {name_of(row)}"


def advice(rows: list[Row]) -> list[Row]:
    """Return the quickest mesh for each error in each scene, with the package's defaults."""
    result = []
    defaults = [row for row in rows if row["axis"] in ("mesh", "reference")]
    for reference in [row for row in defaults if row["axis"] == "reference"]:
        for error in ERRORS:
            own = converged(defaults, reference["scene"], error)
            result += advice_on(error, own, reference)
    return result


def advice_on(error: str, own: list[Row], reference: Row) -> Iterator[Row]:
    """Yield the quickest mesh for each target of one kind of error, up to the first missed target.

    The error of a number may be small by chance. So the error of a row is replaced by the largest
    of these: its own error, the errors on all finer meshes of its kind, and the reference's error.
    """
    doubtful = [{**row, error: max(row[error], reference[error])} for row in own]
    lasting = [{**row, error: max(worst(error, row, doubtful))} for row in doubtful]
    picks = list(picked(error, lasting)) if own else []
    for (name, missed), same in groupby(picks, lambda pick: (name_of(pick[1]), pick[2])):
        targets, rows, _ = zip(*same, strict=True)
        row = rows[0]
        known = error != "energy" and reference[error] > row[error] / 3
        doubt = f" ± {100 * reference[error]:.2g} %" if known else ""
        yield {
            **row,
            "scene": TITLES[row["scene"]],
            "error": f"{ERRORS[error]}, {' to '.join(f'{100 * t:g}' for t in ends(targets))} %",
            "take": ("not reached: " if missed else "") + name,
            "reached": f"{100 * row[error]:.2g} %{doubt}" if row[error] > EXACT else "rounding",
        }


def picked(error: str, rows: list[Row]) -> Iterator[tuple[float, Row, bool]]:
    """Yield (target, quickest row, whether missed) for each target, up to the first missed one."""
    best = min(row[error] for row in rows)
    for target in TARGETS:
        enough = [row for row in rows if row[error] <= target]
        enough_or_best = enough or [row for row in rows if row[error] <= best / GAIN]
        yield target, min(enough_or_best, key=lambda row: row["seconds"]), not enough
        if not enough:
            return  # smaller targets will be missed, too


def ends(values: Sequence[float]) -> Sequence[float]:
    """Return the first and the last value; a single value alone."""
    return values if len(values) == 1 else (values[0], values[-1])


def worst(error: str, row: Row, rows: list[Row]) -> Iterator[float]:
    """Yield the error of a row, and the errors of rows on finer meshes of its kind."""
    yield row[error]
    for other in rows:
        if all(other[name] == row[name] for name in ("family", "axis")) and other["n"] > row["n"]:
            yield other[error]


def effectivity_lines(rows: list[Row], scene: str) -> Iterator[str]:
    """Yield a line with the range of estimate / error for each kind of mesh."""
    plain = [row for row in converged(rows, scene) if row["axis"] in ("mesh", "backend")]
    own = [row for row in plain if row["effectivity"] is not None]
    for kind in dict.fromkeys(row["family"] for row in own):
        values = [row["effectivity"] for row in own if row["family"] == kind]
        yield f"{scene}, {kind}: estimate / error from {min(values):.2f} to {max(values):.2f}"


def summary(rows: list[Row]) -> str:
    """Return the lines of `part_lines`, `front_lines` and `effectivity_lines` of each scene."""
    scenes = dict.fromkeys(row["scene"] for row in rows)
    kinds = (part_lines, front_lines, effectivity_lines)
    return "\n".join(line for scene in scenes for kind in kinds for line in kind(rows, scene))


#: Family of meshes -> name, colour, and width of the line; adaptive meshes stand out.
KINDS = {
    "P1": ("tetrahedra, degree 1", "#9ecae1", 1.2),
    "P2": ("tetrahedra, degree 2", "#fdae6b", 1.2),
    "Q1": ("hexahedra, degree 1", "#bdbdbd", 1.2),
    "Q2": ("hexahedra, degree 2", "#969696", 1.2),
    "Q2 graded": ("hexahedra, degree 2, graded by hand", "#31a354", 1.6),
    "P1 adaptive": ("adaptive, degree 1", "#08519c", 2.2),
    "P2 adaptive": ("adaptive, degree 2", "#d94801", 2.2),
    "P2 for force": ("adaptive for the force, degree 2", "#756bb1", 1.6),
}
TITLES = {"two_bricks": "two bricks", "hertz": "Hertz", "implant": "implant", "crane": "crane"}


def drawn(rows: list[Row]) -> list[str]:
    """Return the kinds of errors that are drawn for a scene."""
    force = max((row["force"] for row in rows), default=0.0)
    return ["energy", "pressure", "force" if force > EXACT else "slip"]


def draw(path: Path, rows: list[Row]) -> None:
    """Save a picture of errors against seconds: a row for each scene, a column for each error."""
    from matplotlib.lines import Line2D

    rows = list(filter(is_full, rows)) or rows  # a quick run has only rows with coarser references
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    figure, panels = new_figure(1.0 + 2.2 * len(scenes), len(scenes), 3)
    for line, scene in zip(panels, scenes, strict=True):
        plain = [row for row in converged(rows, scene) if row["axis"] in ("mesh", "reference")]
        reference = next(r for r in rows if r["scene"] == scene and r["axis"] == "reference")
        for panel, error in zip(line, drawn(plain), strict=True):
            own = converged(plain, scene, error)
            draw_errors(panel, own, error, reference[error])
            panel.set_title(f"{TITLES.get(scene, scene)}: {ERRORS[error]}", fontsize=10)
        line[0].set_ylabel("relative error")
    for panel in panels[-1]:
        panel.set_xlabel("seconds, from geometry to answer")
    found = {row["family"] for row in rows if row["axis"] == "mesh"}
    handles = [
        Line2D([], [], color=color, lw=width, marker="o", ms=4, label=label)
        for kind, (label, color, width) in KINDS.items()
        if kind in found
    ]
    handles.append(Line2D([], [], color="0.4", ls=":", label="not resolved below"))
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    save(figure, path)


def draw_errors(panel: Any, rows: list[Row], error: str, unresolved: float) -> None:
    """Draw an error against seconds: a curve for each kind of mesh."""
    for family, (_, color, width) in KINDS.items():
        runs = [row for row in rows if row["family"] == family]
        runs.sort(key=lambda row: row["n"])
        panel.loglog(
            [row["seconds"] for row in runs], [row[error] for row in runs], "o-", ms=3.5,
            color=color, lw=width,
        )  # fmt: skip
    panel.axhline(unresolved, color="0.4", ls=":", lw=1.2)
    least = max(min(row[error] for row in rows), 0.3 * unresolved)
    panel.set_ylim(0.7 * least, 1.5 * max(row[error] for row in rows))
    plain_ticks(panel.xaxis)
    percent_ticks(panel.yaxis)
    panel.grid(lw=0.3, color="0.85")
    panel.spines[["top", "right"]].set_visible(False)


def parts(rows: list[Row]) -> list[Row]:
    """Return the rows of axis "part", with errors divided as in `over_mesh`."""
    scenes = dict.fromkeys(row["scene"] for row in rows)
    found = (row for scene in scenes for row in over_mesh(converged(rows, scene)))
    return [row for row in found if row["axis"] == "part"]


def products(rows: list[Row]) -> str:
    """Return the products of each scene with Cholesky and P1 meshes, as text."""
    own = [row for row in rows if (row["family"], row["chosen"]) == ("P1", "cholesky")]
    return " / ".join(str(row["products"]) for row in own)


def range_of(error: str) -> Column:
    """Return the column with the range of an error, relative to the best run."""

    def text(rows: Sequence[Row]) -> str:
        values = [row[error] for row in rows if error in row]
        least, most = f"{min(values):.2f}", f"{max(values):.2f}"
        return least if least == most else f"{least} to {most}"

    return Column(error, text)


def is_full(row: Row) -> bool:
    """Return whether a row belongs to a full run, with the finest meshes and references."""
    return not row["quick"]


TABLES = [
    Table(
        "tradeoff",
        [
            Column("scene", "{scene}"),
            Column("error", "{error}"),
            Column("take", "{take}"),
            Column("n", "{n:,}"),
            Column("seconds", "{seconds:.1f}"),
            Column("MB", "{memory_mb:.0f}"),
            Column("reached", "{reached}"),
        ],
        chosen=is_full,
        line=["scene", "error"],
        derived=advice,
    ),
    Table(
        "tradeoff_parts",
        [
            Column("part", "{part:g}"),
            Column("products", products),
            *map(range_of, ("energy", "pressure", "slip")),
        ],
        chosen=is_full,
        line=["part"],
        derived=parts,
    ),
]
