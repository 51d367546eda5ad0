"""Package map: draws the packages of each floor and their imports, and writes the page that shows them.

`make map` runs it; `tests/docs/test_reference.py` holds page and pictures current. An arrow means "imports"; an
import that a longer chain of arrows implies is left out of the picture and listed in the table.
"""

import ast
import sys
from collections.abc import Sequence
from html import escape
from importlib.util import find_spec
from pathlib import Path

import grimp

#: package whose children are drawn, and its title
FLOORS = {
    "service": "The service",
    "service.frontend": "The front end",
    "db": "The database",
    "analyzer_sim": "The simulator",
}
ROOTS = ("service", "db", "analyzer_sim")
BOX_HEIGHT, ROW_HEIGHT, GAP, LETTER = 30, 68, 18, 8.4
Edges = dict[str, set[str]]


def imports_of(graph: grimp.ImportGraph, floor: str) -> Edges:
    """Return, for each child of a package, the other children that it imports; other roots count as one child."""

    def child(module: str) -> str:
        inner = module.removeprefix(f"{floor}.")
        return inner.split(".")[0] if inner != module else module.split(".")[0]

    edges: Edges = {child(each): set() for each in graph.find_children(floor)}
    # the database stands between the composition root and the ports that it implements
    inside = ("service", "db") if floor == "service" else (floor,)
    for module in sorted(each for each in graph.modules if each.startswith(tuple(f"{name}." for name in inside))):
        found = {child(each) for each in graph.find_modules_directly_imported_by(module) if each != floor}
        edges.setdefault(child(module), set()).update(found - {child(module), floor.split(".")[0]})
    for outside in set().union(*edges.values()) - edges.keys():
        edges[outside] = set()
    return edges


def reached(edges: Edges, start: str) -> set[str]:
    """Return everything that a node imports, over any number of steps."""
    found: set[str] = set()
    waiting = [start]
    while waiting:
        new = edges[waiting.pop()] - found
        found |= new
        waiting += new
    return found


def reduced(edges: Edges) -> Edges:
    """Return the arrows that no chain of other arrows implies."""
    return {
        name: targets - set().union(*(reached(edges, target) for target in targets)) for name, targets in edges.items()
    }


def depths(edges: Edges) -> dict[str, int]:
    """Return the level of each node: 0 imports nothing, every other one stands above all that it imports."""
    found: dict[str, int] = {}

    def depth(name: str) -> int:
        if name not in found:
            found[name] = 1 + max((depth(target) for target in sorted(edges[name])), default=-1)
        return found[name]

    return {name: depth(name) for name in sorted(edges)}


def routed(arrows: Edges, level: dict[str, int]) -> Edges:
    """Return the arrows with a point of passage (``a>b@level``) on each level that they cross; levels are extended."""
    legs: Edges = {name: set() for name in arrows}
    for name, target in ((one, other) for one in sorted(arrows) for other in sorted(arrows[one])):
        start = name
        for between in range(level[name] - 1, level[target], -1):
            passage = f"{name}>{target}@{between}"
            level[passage], legs[passage] = between, set()
            legs[start].add(passage)
            start = passage
        legs[start].add(target)
    return legs


def rows_of(legs: Edges, level: dict[str, int]) -> list[list[str]]:
    """Return the nodes in rows, importers above; each row in the order of what it leads to."""
    rows = [[name for name in sorted(legs) if level[name] == number] for number in range(1 + max(level.values()))]
    position: dict[str, float] = {}
    for row in rows:
        row.sort(key=lambda name: (mean([position[target] for target in legs[name]]), name))
        position |= {name: (number + 1) / (len(row) + 1) for number, name in enumerate(row)}
    return rows[::-1]


def mean(values: Sequence[float]) -> float:
    """Return the mean, the middle for nothing."""
    return round(sum(values) / len(values), 9) if values else 0.5


def picture(edges: Edges, title: str) -> str:
    """Return the picture of a floor as SVG."""
    arrows = reduced(edges)
    level = depths(arrows)
    legs = routed(arrows, level)
    rows = rows_of(legs, level)
    widths = {name: 0 if "@" in name else round(LETTER * len(name) + 24) for name in legs}
    row_widths = [sum(widths[name] for name in row) + GAP * (len(row) + 1) for row in rows]
    width, height = max(row_widths), ROW_HEIGHT * len(rows)
    centre: dict[str, tuple[float, float]] = {}
    for number, row in enumerate(rows):
        x = (width - row_widths[number]) / 2 + GAP
        for name in row:
            centre[name] = (x + widths[name] / 2, number * ROW_HEIGHT + ROW_HEIGHT / 2)
            x += widths[name] + GAP
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}" '
        'font-family="DejaVu Sans Mono, monospace" font-size="14">',
        f"<title>{escape(title)}: packages and their imports</title>",
        f'<rect width="{width}" height="{height}" fill="#ffffff"/>',
        '<defs><marker id="tip" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0 0 10 5 0 10z" fill="#5b6b7b"/></marker></defs>',
        *(leg(centre[name], centre[target], name, target) for name in sorted(legs) for target in sorted(legs[name])),
    ]
    for name, (x, y) in sorted(centre.items()):
        if "@" not in name:
            lines += [
                f'<rect x="{x - widths[name] / 2:.0f}" y="{y - BOX_HEIGHT / 2:.0f}" width="{widths[name]}" '
                f'height="{BOX_HEIGHT}" rx="5" fill="#e8f0f8" stroke="#33475b"/>',
                f'<text x="{x:.0f}" y="{y + 5:.0f}" text-anchor="middle">{escape(name)}</text>',
            ]
    return "\n".join([*lines, "</svg>", ""])


def leg(start: tuple[float, float], stop: tuple[float, float], name: str, target: str) -> str:
    """Return one leg of an arrow, with a tip where it ends at a box."""
    y1 = start[1] + (0 if "@" in name else BOX_HEIGHT / 2)
    y2 = stop[1] - (0 if "@" in target else BOX_HEIGHT / 2 + 1)
    middle = (y1 + y2) / 2
    tip = "" if "@" in target else ' marker-end="url(#tip)"'
    return (
        f'<path d="M{start[0]:.0f} {y1:.0f}C{start[0]:.0f} {middle:.0f} {stop[0]:.0f} {middle:.0f} {stop[0]:.0f} '
        f'{y2:.0f}" fill="none" stroke="#5b6b7b" stroke-width="1.2"{tip}/>'
    )


def sentence(module: str) -> str:
    """Return the first line of a module's docstring."""
    spec = find_spec(module)
    source = Path(spec.origin).read_text() if spec and spec.origin else ""
    return (ast.get_docstring(ast.parse(source)) or "-").splitlines()[0].replace("|", "\\|")


def page(floors: dict[str, Edges]) -> str:
    """Return the page of the map."""
    lines = [
        "# Package map",
        "",
        "Drawn from the imports by `make map`; `tests/docs/test_reference.py` holds it current. An arrow means",
        '"imports". A package imports only what stands below it, and no two packages import each other',
        "(`make imports`). The table lists every import, the picture leaves out those that longer chains imply.",
    ]
    for floor, edges in floors.items():
        level = depths(edges)
        lines += ["", f"## {FLOORS[floor]}", "", f"![Packages of {floor} and their imports]({image_of(floor)})", ""]
        lines += ["| package | what it is | imports |", "|---|---|---|"]
        for name in sorted(level, key=lambda name: (-level[name], name)):
            module = name if name in ROOTS else f"{floor}.{name}"
            lines.append(f"| `{name}` | {sentence(module)} | {', '.join(sorted(edges[name])) or '-'} |")
    return "\n".join([*lines, ""])


def image_of(floor: str) -> str:
    """Return the path of a picture from the page."""
    return f"../images/packages-{floor.replace('.', '-')}.svg"


def main(docs: Path) -> None:
    """Write page and pictures below a folder of documents."""
    graph = grimp.build_graph(*ROOTS)
    floors = {floor: imports_of(graph, floor) for floor in FLOORS}
    where = docs / "explanations" / "package-map.md"
    where.write_text(page(floors))
    for floor, edges in floors.items():
        (where.parent / image_of(floor)).resolve().write_text(picture(edges, FLOORS[floor]))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
