"""Tables and the picture of benchmarks/tradeoff.py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dolfinx_tresca.optimise import stopping

Row = dict[str, Any]

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


def draw(path: Path, rows: list[Row]) -> None:
    """Save errors over costs as a picture."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    panels = [("energy", "seconds"), ("pressure", "seconds"), ("slip", "seconds"),
              ("energy", "memory_mb")]  # fmt: skip
    figure, axes = plt.subplots(
        len(scenes), 5, figsize=(19, 3.7 * len(scenes)), squeeze=False, layout="constrained"
    )
    kinds = list(dict.fromkeys(row["family"] for row in rows if row["axis"] == "mesh"))
    ticks = [digit * 10.0**k for k in (-4, -3, -2, -1) for digit in (1, 2, 5)] + [1.0]
    for line, scene in zip(axes, scenes, strict=True):
        reference = next(r for r in rows if r["scene"] == scene and r["axis"] == "reference")
        for panel, (error, cost) in zip(line, panels, strict=False):
            own = converged(rows, scene, error)
            if not own:
                panel.set_axis_off()
                continue
            others = [row for row in own if row["axis"] != "mesh"]
            panel.loglog([r[cost] for r in others], [r[error] for r in others], ".",
                         color="0.75", ms=4, label="other settings", zorder=1)  # fmt: skip
            for number, kind in enumerate(kinds):
                runs = [r for r in own if r["axis"] == "mesh" and r["family"] == kind]
                if runs:
                    panel.loglog([r[cost] for r in runs], [r[error] for r in runs], "o-", ms=4,
                                 color=f"C{number}", label=f"{kind}, defaults")  # fmt: skip
            best = front(own, error, cost)
            panel.loglog([r[cost] for r in best], [r[error] for r in best], color="black", lw=1,
                         drawstyle="steps-post", label="Pareto front", zorder=0)  # fmt: skip
            panel.axhline(reference[error], color="0.5", ls=":", label="error of the reference")
            panel.set(title=f"{scene}: {error}", xlabel=cost.replace("_mb", " [MB]"))
            panel.set_yticks(ticks, [f"{100 * tick:g} %" for tick in ticks], minor=False)
            panel.set_yticks([], minor=True)
            lowest = min(row[error] for row in own)
            panel.set_ylim(0.8 * min(lowest, reference[error]), 1.0)
            panel.grid(True, which="both", lw=0.2)
        line[0].set_ylabel("relative error")
        draw_balance(line[4], converged(rows, scene), scene)
    handles, labels = axes[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def draw_balance(panel: Any, rows: list[Row], scene: str) -> None:
    """Draw the whole error over that of the mesh, over products."""
    own = [row for row in rows if row["axis"] in ("part", "rtol")]
    for index, kind in enumerate(dict.fromkeys((r["family"], r["size"]) for r in own)):
        for error, style in (("energy", "-"), ("pressure", "--"), ("slip", ":")):
            runs = [r for r in own if (r["family"], r["size"]) == kind and error in r]
            runs = [r for r in runs if r["chosen"] == "cholesky"]
            if not runs:
                continue
            best = min(runs, key=lambda r: r["algebra_error"])
            points = sorted((r["products"], r[error] / best[error]) for r in runs)
            panel.plot(*zip(*points, strict=True), style, color=f"C{index}", lw=1,
                       label=f"{kind[0]} {kind[1]:g}: {error}")  # fmt: skip
            for r in runs:
                if r["axis"] == "part":
                    default = r["part"] == stopping.BALANCED
                    panel.plot(r["products"], r[error] / best[error], "*" if default else ".",
                               color=f"C{index}", ms=10 if default else 4)  # fmt: skip
    panel.set(title=f"{scene}: star = balanced", xlabel="products", ylabel="error / mesh error")
    panel.set_ylim(0.8, 1.5)
    panel.grid(True, lw=0.2)
    if own:
        panel.legend(fontsize=7)
