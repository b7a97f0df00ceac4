"""Measure a program's answers by the published cases; only numpy is needed.

    python3 yardstick/check.py ANSWERS.json ...

`README.md` beside this script describes the files. For each case and quantity of the answers a line
says what was published, the value on the finest mesh, its distance from the published range in
percent, and what the value may still change: a Richardson extrapolation from the last three meshes
whose cells shrink by a constant factor, of at most the case's order. Without three such meshes this
column is empty. A script exits with 1 if a case, a quantity or a number is not as described.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np

#: Folder of the cases.
CASES = Path(__file__).with_name("cases")

#: The observed order of convergence is not trusted below this number.
LEAST_ORDER = 0.5


def published_range(value: float | dict) -> tuple[float, float]:
    """Return the lowest and the highest published value of a quantity.

    Args:
        value: the entry of the case's file: a number, {"low", "high"}, or {"values"} of groups,
            perhaps with "rounding", half of their last digit.
    """
    if not isinstance(value, dict):
        return float(value), float(value)
    if "low" in value:
        return float(value["low"]), float(value["high"])
    values, rounding = list(value["values"].values()), value.get("rounding", 0.0)
    return min(values) - rounding, max(values) + rounding


def distance(value: float, low: float, high: float) -> float:
    """Return how far a value is from the published range, relative to its nearer end; 0: inside."""
    nearest = float(np.clip(value, low, high))
    return (value - nearest) / abs(nearest) if value != nearest else 0.0


def own_error(sizes: list[float], values: list[float], order: float) -> float | None:
    """Return the estimated relative error of the last value; None if there are too few meshes.

    Args:
        sizes: sizes of the meshes, or numbers of cells, from coarse to fine.
        values: values on these meshes.
        order: the order of convergence by theory.
    """
    if len(values) < 3 or values[-1] == 0.0:
        return None
    ratios = np.array(sizes[-2:]) / np.array(sizes[-3:-1])
    if not np.isclose(ratios[0], ratios[1], rtol=0.05):
        return None
    factor = float(np.exp(abs(np.log(ratios[1]))))
    before, after = np.diff(values[-3:])
    if before * after <= 0.0:  # values oscillate, or do not change
        return float(max(abs(before), abs(after)) / abs(values[-1]))
    observed = np.clip(np.log(before / after) / np.log(factor), LEAST_ORDER, order)
    return float(abs(after) / (factor**observed - 1.0) / abs(values[-1]))


def measured(path: Path) -> list[dict]:
    """Return a row for each case and quantity that a file of answers has.

    Raises:
        ValueError: the file cannot be read, a field is missing, a case or a quantity does not
            exist, or a value is no number.
    """
    answers: dict[tuple[str, str], list[tuple[float, float]]] = {}
    try:
        content = json.loads(path.read_text())
    except (OSError, json.JSONDecodeError) as error:
        raise ValueError(f"{path} cannot be read: {error}") from error
    if not isinstance(content, dict) or not isinstance(content.get("rows"), list):
        raise ValueError(f'{path}: answers have the form {{"program": ..., "rows": [...]}}')
    for row in content["rows"]:
        if "quantity" not in row:
            continue  # the program was stopped
        if missing := {"case", "size", "value"} - row.keys():
            raise ValueError(f"{path}: a row has no {', '.join(sorted(missing))}: {row}")
        if not np.isfinite(row["value"]):
            raise ValueError(f"{path}: {row['case']}: {row['quantity']}: {row['value']}")
        key = row["case"], row["quantity"]
        answers.setdefault(key, []).append((row["size"], row["value"]))
    result = []
    for (name, quantity), meshes in answers.items():
        file = CASES / f"{name}.json"
        if not file.exists():
            raise ValueError(f"{path}: there is no case {name}: {CASES} has them")
        case = json.loads(file.read_text())
        if quantity not in case["published"]:
            names = ", ".join(case["published"])
            raise ValueError(f"{path}: {name} has no quantity {quantity!r}, but: {names}")
        coarse_first = case["sizes"][-1] >= case["sizes"][0]
        sizes, values = map(list, zip(*sorted(meshes, reverse=not coarse_first), strict=True))
        low, high = published_range(case["published"][quantity])
        result.append(
            {
                "program": content.get("program", path.stem),
                "case": name,
                "quantity": quantity,
                "low": low,
                "high": high,
                "size": sizes[-1],
                "value": values[-1],
                "off": distance(values[-1], low, high),
                "error": own_error(sizes, values, case.get("order", 2.0)),
            }
        )
    return result


def main() -> None:
    """Print the rows of all files that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("answers", nargs="+", type=Path, help="files of answers")
    try:
        rows = [row for path in parser.parse_args().answers for row in measured(path)]
    except ValueError as error:
        sys.exit(f"yardstick: {error}")
    for row in rows:
        published = " to ".join(dict.fromkeys(f"{row[end]:.5g}" for end in ("low", "high")))
        off = "inside" if row["off"] == 0.0 else f"{100.0 * row['off']:+.2g} %"
        error = "" if row["error"] is None else f"± {100.0 * row['error']:.1g} %"
        print(f"{row['program']}: {row['case']}: {row['quantity']}")
        value = f"size {row['size']:g}: {row['value']:.5g} ({off}) {error}"
        print(f"    published {published}, {value}".rstrip())


if __name__ == "__main__":
    main()
