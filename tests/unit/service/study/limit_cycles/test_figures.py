"""Figures are drawn, and drawn the same again."""

from service.study.limit_cycles import figures

NAMES = ["bi-plane", "cycles", "ladder", "stability"]


def test_four_figures_as_images(tmp_path):
    paths = figures.draw_figures(tmp_path)
    assert [path.name for path in paths] == [f"limit-cycles-{name}.png" for name in NAMES]
    assert all(path.read_bytes().startswith(b"\x89PNG") and path.stat().st_size > 20_000 for path in paths)


def test_the_same_figure_is_the_same_file(tmp_path):
    drawn = []
    for name in ("one.svg", "two.svg"):
        with figures.mpl.rc_context({"svg.hashsalt": "soo"}):
            figures._draw_stability(tmp_path / name)
        drawn.append((tmp_path / name).read_bytes())
    assert drawn[0] == drawn[1]
