"""Fits a model to the CSV of benches/growth.rs, prints it, and plots both. Plain Python.

    cargo bench --bench growth >growth.csv; python3 benches/growth.py growth.csv growth.svg
"""

import math
import sys

TERMS = {"constant": lambda r: 1.0, "batch": lambda r: r["batch"], "parameters": lambda r: r["parameters"],
         "flop": lambda r: r["flop"]}


def read(path):
    """The two tables: updates and replay."""
    tables = open(path).read().strip().split("\n\n")
    for table in tables:
        names, *rows = (line.split(",") for line in table.splitlines())
        yield [{n: v if n == "series" else float(v) for n, v in zip(names, row)} for row in rows]


def solve(matrix, vector):
    """Gauss-Jordan elimination with pivoting."""
    rows = [[*row, value] for row, value in zip(matrix, vector)]
    for i in range(len(rows)):
        pivot = max(range(i, len(rows)), key=lambda j: abs(rows[j][i]))
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [x / rows[i][i] for x in rows[i]]
        for j in range(len(rows)):
            if j != i:
                rows[j] = [x - rows[j][i] * y for x, y in zip(rows[j], rows[i])]
    return [row[-1] for row in rows]


def fit(rows):
    """Coefficients of the least squares of the relative errors; terms that come out negative are left out."""
    terms = dict(TERMS)
    while True:
        design = [[term(r) / r["us_per_update"] for term in terms.values()] for r in rows]
        columns = list(zip(*design))
        normal = [[sum(a * b for a, b in zip(x, y)) for y in columns] for x in columns]
        coefficients = dict(zip(terms, solve(normal, [sum(x) for x in columns])))
        negative = [name for name, value in coefficients.items() if value < 0]
        if not negative:
            return coefficients
        for name in negative:
            del terms[name]


def predict(coefficients, row):
    return sum(value * TERMS[name](row) for name, value in coefficients.items())


def ticks(low, high):
    return [10.0**e for e in range(math.ceil(math.log10(low) - 1e-9), math.floor(math.log10(high) + 1e-9) + 1)]


def panel(left, top, title, x_name, y_name, points, lines, x_log=True):
    """One plot: points [(x, y)] in groups, lines [(x, y)] in groups; y logarithmic unless it spans less than 3 times."""
    width, height, colours = 300, 220, ["#1b6ca8", "#c8553d"]
    xs, ys = zip(*(point for group in points + lines for point in group))
    y_log = max(ys) > 3 * min(ys)
    x_map = math.log10 if x_log else float
    y_map = math.log10 if y_log else float
    y_low, y_high = (min(ys) / 1.3, max(ys) * 1.3) if y_log else (0, max(ys) * 1.2)
    x_min, x_max, y_min, y_max = x_map(min(xs)), x_map(max(xs)), y_map(y_low), y_map(y_high)
    px = lambda x: left + 10 + (width - 20) * (x_map(x) - x_min) / (x_max - x_min)
    py = lambda y: top + height - height * (y_map(y) - y_min) / (y_max - y_min)
    text = lambda x, y, s, anchor="middle": f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{s}</text>'
    svg = [f'<rect x="{left}" y="{top}" width="{width}" height="{height}" fill="none" stroke="#888"/>']
    svg += [text(left + width / 2, top - 10, title), text(left + width / 2, top + height + 36, x_name)]
    svg.append(text(left, top - 10, y_name))
    for x in sorted({x for group in points for x, _ in group}):
        svg.append(text(px(x), top + height + 18, f"{x:g}".replace("e+0", "e")))
    for y in ticks(y_low, y_high) if y_log else range(0, int(y_high) + 1, 5):
        svg.append(text(left - 6, py(y) + 4, f"{y:g}", "end"))
        svg.append(f'<path d="M{left} {py(y):.1f}h{width}" stroke="#ddd"/>')
    for group, colour in zip(lines, colours):
        path = "L".join(f"{px(x):.1f} {py(y):.1f}" for x, y in group)
        svg.append(f'<path d="M{path}" fill="none" stroke="{colour}" stroke-dasharray="5 3"/>')
    for group, colour in zip(points, colours):
        svg += [f'<circle cx="{px(x):.1f}" cy="{py(y):.1f}" r="3.5" fill="{colour}"/>' for x, y in group]
    return svg


def main(csv, picture):
    updates, replay = read(csv)
    model = fit(updates)
    errors = [predict(model, r) / r["us_per_update"] - 1 for r in updates]
    print("us per update =", " + ".join(f"{value:.4g} {name}" for name, value in model.items()))
    print(f"  = {1e-3 / model['flop']:.1f} GFLOP/s; errors {min(errors):+.0%} to {max(errors):+.0%}")
    svg = []
    titles = {"width": "two layers of this width, batch 64", "batch": "4-64-64-2", "depth": "layers of 64, batch 64"}
    for i, (series, title) in enumerate(titles.items()):
        rows = [r for r in updates if r["series"] == series]
        points = [(r[series], r["us_per_update"]) for r in rows]
        line = [(r[series], predict(model, r)) for r in rows]
        left, top = 60 + 380 * (i % 2), 40 + 310 * (i // 2)
        svg += panel(left, top, title, series, "µs", [points], [line], x_log=series != "depth")
    bytes_of = [[(r["capacity"], r[f"bytes_per_transition_{who}"]) for r in replay] for who in ("trained", "random")]
    flat = [[(r["capacity"], 22.125) for r in replay]]
    svg += panel(440, 350, "trained (blue), random policy (red)", "replay capacity", "bytes", bytes_of, flat)
    head = '<svg xmlns="http://www.w3.org/2000/svg" width="770" height="630" font-family="sans-serif" font-size="12">'
    with open(picture, "w") as file:
        file.write("\n".join([head, '<rect width="100%" height="100%" fill="#fff"/>', *svg, "</svg>\n"]))


if __name__ == "__main__":
    main(*sys.argv[1:])
