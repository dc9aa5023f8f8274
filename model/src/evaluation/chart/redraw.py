#!/usr/bin/env python3
"""Draws a figure again from its numbers: redraw.py NAME_points.csv [FIGURE.pdf|png|svg]. Needs matplotlib."""

import csv
import pathlib
import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

STYLES = {  # style of the CSV: line, mark
    "line": ("-", None), "dotted": ("-", "o"), "dashed": ("--", None), "thin": ("-", None),
    "cross": ("none", "x"), "dot": ("none", "o"), "ring": ("none", "o"), "diamond": ("none", "D"),
    "triangle": ("none", "^"), "square": ("none", "s"), "level": ("--", None),
}

source = pathlib.Path(sys.argv[1])
target = sys.argv[2] if len(sys.argv) > 2 else source.with_name(source.stem.removesuffix("_points") + "_redrawn.pdf")
panels = {}
with source.open(newline="", encoding="utf-8") as file:
    for row in csv.DictReader(file):
        series = panels.setdefault(row["panel"], {})
        series.setdefault((row["series"], row["style"]), []).append(row)

columns = min(3, len(panels))
lines = -(-len(panels) // columns)
figure, axes = plt.subplots(lines, columns, figsize=(5 * columns, 4.2 * lines), squeeze=False)
for axis in axes.flat[len(panels):]:
    axis.axis("off")
for axis, (title, panel) in zip(axes.flat, panels.items()):
    for (name, style), rows in reversed(panel.items()):  # the first lies above
        x, y = ([float(row[key]) for row in rows] for key in "xy")
        name = "" if name.isdigit() else name  # a series without a name has its number
        if style == "area":
            axis.fill(x, y, alpha=0.3, label=name, color="grey")
            continue
        dashes, mark = STYLES[style]
        face = "none" if style in ("ring", "diamond") else None
        drawn = axis.plot(x, y, linestyle=dashes, marker=mark, markerfacecolor=face, markersize=4, linewidth=1, label=name)
        if rows[0]["low"]:
            low, high = ([float(row[key]) for row in rows] for key in ("low", "high"))
            axis.fill_between(x, low, high, alpha=0.15, color=drawn[0].get_color())
    first = next(iter(panel.values()))[0]
    axis.set(title=title, xlabel=first["x_axis"], ylabel=first["y_axis"])
    axis.set_xscale("log" if first["x_axis"].endswith("(log)") else "linear")
    axis.set_yscale("log" if first["y_axis"].endswith("(log)") else "linear")
    axis.legend(fontsize="x-small", loc="upper left", bbox_to_anchor=(0, -0.15), ncols=2)
figure.savefig(target, bbox_inches="tight")
print(target)
