"""Tables and the picture of benchmarks/tradeoff.py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from kept import Row, new_figure, percent_ticks, plain_ticks, save

ERRORS = ("energy", "pressure", "slip")
TARGETS = (0.1, 0.01, 0.001)

#: By how much an error must be smaller to be worth anything; what defaults may take longer than
#: other settings, whose seconds differ by chance too, and still be the advice.
GAIN, CHANCE = 0.97, 1.2

COLUMNS = (
    f"{'scene':<10} {'mesh':<10} {'size':>5} {'n/m':>12} {'axis':<8} {'K-solver':<9} "
    f"{'method, asked for':<22} {'seconds':>7} {'MB':>6} {'iter/n_A':>9} {'energy':>8} "
    f"{'pressure':>8} {'slip':>8} {'mesh':>8} {'algebra':>8} {'bound':>8} {'estimate':>8} "
    f"{'effect.':>7}"
)


def number(value: float | None, form: str = "8.1e") -> str:
    """Return a number or blanks."""
    return " " * int(form.split(".")[0]) if value is None else f"{value:{form}}"


def described(row: Row) -> str:
    """Return how a row was asked for."""
    kind = "" if row["method"] == "projected_newton" else f"{row['method']}, "
    kind += "" if row["pairing"] == "auto" else f"{row['pairing']}, "
    return kind + row["asked"] + ("" if row["krylov"] is None else f", K {row['krylov']:g}")


def print_row(row: Row) -> None:
    """Print a row of the table."""
    print(f"{row['scene']:<10} {row['family']:<10} {row['size']:>5g} ", end="")
    if "seconds" not in row:
        print(f"{'':>12} {row['axis']:<8} {row['stiffness']:<9} {described(row)}: {row['status']}")
        return
    sizes, work = f"{row['n']}/{row['m']}", f"{row['iterations']}/{row['products']}"
    failed = "" if row["status"] == "CONVERGED" else f" {row['status']}"
    print(
        f"{sizes:>12} {row['axis']:<8} {row['chosen']:<9} {described(row):<22} "
        f"{row['seconds']:>7.2f} {row['memory_mb']:>6.0f} {work:>9} {row['energy']:>8.1e} "
        f"{row['pressure']:>8.1e} {number(row.get('slip'))} {row['mesh_error']:>8.1e} "
        f"{row['algebra_error']:>8.1e} {row['energy_error_bound']:>8.1e} "
        f"{number(row['discretisation_error'])} {number(row['effectivity'], '7.2f')}{failed}",
        flush=True,
    )


def front(rows: list[Row], error: str, cost: str) -> list[Row]:
    """Return the rows that no other one beats in both, cheap to dear; tiny gains are none."""
    result: list[Row] = []
    for row in sorted(rows, key=lambda row: (row[cost], row[error])):
        if not result or row[error] < GAIN * result[-1][error]:
            result.append(row)
    return result


def converged(rows: list[Row], scene: str, error: str = "energy") -> list[Row]:
    """Return the rows of a scene that have this error."""
    return [
        row
        for row in rows
        if row["scene"] == scene and row.get("status") == "CONVERGED" and error in row
    ]


def print_parts(rows: list[Row], scene: str) -> None:
    """Print what the balance of errors costs and brings."""
    own = [row for row in converged(rows, scene) if row["axis"] in ("part", "rtol")]
    meshes = dict.fromkeys((row["family"], row["size"], row["chosen"]) for row in own)
    for key in meshes:
        runs = [row for row in own if (row["family"], row["size"], row["chosen"]) == key]
        best = min(runs, key=lambda row: row["algebra_error"])
        least = min(row["seconds"] for row in runs)
        print(f"\n{scene}, {key[0]} of size {key[1]:g}, {key[2]}: errors over the mesh's own")
        print(f"{'asked for':<12} {'products':>8} {'seconds':>8} " + " ".join(
            f"{error:>9}" for error in ("algebra", *ERRORS) if error in best or error == "algebra"
        ))  # fmt: skip
        for row in runs:
            parts = [row["algebra_error"] / row["mesh_error"]]
            parts += [row[error] / best[error] for error in ERRORS if error in best]
            print(
                f"{row['asked']:<12} {row['products']:>8} {row['seconds'] / least:>7.2f}x "
                + " ".join(f"{part:>9.3f}" for part in parts)
            )


def name_of(row: Row) -> str:
    """Return what a row is, shortly."""
    return f"{row['family']} {row['size']:g}, {row['chosen']}, {described(row)}"


def print_fronts(rows: list[Row], scene: str) -> None:
    """Print the Pareto fronts of a scene."""
    for error in ERRORS:
        own = converged(rows, scene, error)
        for cost, unit in (("seconds", "s"), ("memory_mb", "MB")):
            if own:
                print(f"\n{scene}, Pareto front: {error} over {cost}")
            for row in front(own, error, cost):
                print(f"  {row[error]:8.1e} {row[cost]:9.2f} {unit:<2}  {name_of(row)}")


def cheapest(rows: list[Row]) -> Row:
    """Return the quickest run; one with all defaults where that is as quick."""
    least = min(row["seconds"] for row in rows)
    quick = [row for row in rows if row["seconds"] <= CHANCE * least]
    defaults = [row for row in quick if row["axis"] == "mesh"]
    return min(defaults or quick, key=lambda row: row["seconds"])


def print_advice(rows: list[Row], scene: str) -> None:
    """Print what to take for an error."""
    reference = next(r for r in rows if r["scene"] == scene and r["axis"] == "reference")
    print(f"\n| {scene} | error | take | seconds | MB | n | reached | least memory |")
    print("|" + "---|" * 8)
    for error in ERRORS:
        print_advice_on(error, converged(rows, scene, error), reference)


def print_advice_on(error: str, own: list[Row], reference: Row) -> None:
    """Print what to take for one kind of error, up to what is reached."""
    for target in TARGETS if own else ():
        enough = [row for row in own if row[error] <= target]
        best = min(row[error] for row in own)
        row = cheapest(enough or [row for row in own if row[error] <= best / GAIN])
        small = front(enough, error, "memory_mb")[:1]
        doubt = f" ± {100 * reference[error]:.2g} %" if reference[error] > row[error] / 3 else ""
        print(
            f"| {error} | {100 * target:g} % | {'' if enough else 'not reached; best: '}"
            f"{name_of(row)} | {row['seconds']:.2f} | {row['memory_mb']:.0f} | {row['n']} | "
            f"{100 * row[error]:.2g} %{doubt} | "
            + "".join(f"{other['memory_mb']:.0f} MB: {name_of(other)}" for other in small)
            + " |"
        )
        if not enough:
            break  # nor will less be


def print_effectivity(rows: list[Row], scene: str) -> None:
    """Print the range of estimate over error for each kind of mesh."""
    plain = [row for row in converged(rows, scene) if row["axis"] in ("mesh", "backend")]
    own = [row for row in plain if row["effectivity"] is not None]
    print()
    for kind in dict.fromkeys(row["family"] for row in own):
        values = [row["effectivity"] for row in own if row["family"] == kind]
        print(f"{scene}, {kind}: estimate / error from {min(values):.2f} to {max(values):.2f}")


KINDS = {
    "P1": "tetrahedra, degree 1",
    "P2": "tetrahedra, degree 2",
    "Q1": "hexahedra, degree 1",
    "Q2": "hexahedra, degree 2",
    "Q2 graded": "hexahedra, degree 2, graded",
}
TITLES = {"two_bricks": "two bricks", "hertz": "Hertz", "implant": "implant"}


def draw(path: Path, rows: list[Row]) -> None:
    """Save errors over seconds as a picture: a row for each scene, a column for each error."""
    from matplotlib.lines import Line2D

    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    figure, panels = new_figure(0.7 + 2.3 * len(scenes), len(scenes), len(ERRORS), sharex=True)
    kinds = list(dict.fromkeys(row["family"] for row in rows if row["axis"] == "mesh"))
    for line, scene in zip(panels, scenes, strict=True):
        for panel, error in zip(line, ERRORS, strict=True):
            own = converged(rows, scene, error)
            if own:
                draw_errors(panel, own, error, kinds)
                reference = next(
                    r for r in rows if r["scene"] == scene and r["axis"] == "reference"
                )
                panel.axhline(reference[error], color="0.4", ls=":", lw=1.2)
                panel.set_ylim(0.8 * min(reference[error], min(r[error] for r in own)), 1.0)
                panel.set_title(f"{TITLES.get(scene, scene)}: {error}", fontsize=10)
            else:
                panel.set_axis_off()
        line[0].set_ylabel("relative error")
    for panel in panels[-1]:
        panel.set_xlabel("seconds")
    handles = [
        Line2D([], [], color=f"C{i}", marker="o", ms=4, label=KINDS.get(kind, kind))
        for i, kind in enumerate(kinds)
    ]
    handles += [
        Line2D([], [], ls="", marker=".", color="0.7", label="other settings"),
        Line2D([], [], color="0.4", ls=":", label="error of the reference itself"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    save(figure, path)


def draw_errors(panel: Any, rows: list[Row], error: str, kinds: list[str]) -> None:
    """Draw an error over seconds: a curve for each kind of mesh, dots for other settings."""
    others = [row for row in rows if row["axis"] != "mesh"]
    panel.loglog(
        [row["seconds"] for row in others], [row[error] for row in others], ".", color="0.7", ms=4,
        zorder=1,
    )  # fmt: skip
    for number, kind in enumerate(kinds):
        runs = [row for row in rows if row["axis"] == "mesh" and row["family"] == kind]
        panel.loglog(
            [row["seconds"] for row in runs], [row[error] for row in runs], "o-", ms=4,
            color=f"C{number}",
        )  # fmt: skip
    plain_ticks(panel.xaxis)
    percent_ticks(panel.yaxis)
    panel.grid(lw=0.3, color="0.85")
    panel.spines[["top", "right"]].set_visible(False)
