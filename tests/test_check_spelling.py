"""check: G-code in other legal spellings, SVG with transforms and hidden shapes, malformed numbers."""

import numpy as np
import pytest

from rasterslice.check.readers import read
from rasterslice.errors import RasterSliceError

PLAIN = ";LAYER_CHANGE\nG1 Z.4\n;TYPE:External perimeter\nM82\nG1 X1 Y2\nG1 X3 Y2 E2\nG1 X3 Y5 E5\nG1 X1 Y2 E8.606\n"
SPELLED = {
    "zero": lambda t: t.replace("G1 ", "G01 "),
    "numbered": lambda t: t.replace("G1 ", "N10 G1 "),
    "blanks before": lambda t: t.replace("G1 ", "  G1 "),
    "no blanks": lambda t: t.replace(" X", "X").replace(" Y", "Y").replace(" E", "E").replace(" Z", "Z"),
    "words together": lambda t: t.replace(" Y", "Y").replace(" E", "E"),
    "small letters": lambda t: t.replace("G1 X", "g1 x"),
    "checked": lambda t: t.replace("G1 X3 Y5 E5", "N7 G1 X3 Y5 E5*104"),
    "remarks": lambda t: t.replace("G1 X3 Y5", "G1 (corner) X3 Y5"),
}


@pytest.mark.parametrize("way", SPELLED)
def test_spellings_of_gcode(way, tmp_path):
    path = tmp_path / "a.gcode"
    path.write_text(SPELLED[way](PLAIN))
    assert path.read_text() != PLAIN
    assert read(path).layers[0].beads.points.tolist() == [[1, 2], [3, 2], [3, 5], [1, 2]]


@pytest.mark.parametrize("bad", ["E nan", "Enan", "X1_0 E2", "X1.2.3 E2", "Einf"])
def test_malformed_numbers_name_their_line(bad, tmp_path):
    path = tmp_path / "a.gcode"
    path.write_text(PLAIN + f"G1 X4 {bad}\n")
    with pytest.raises(RasterSliceError, match=r"a.gcode:9: "):
        read(path)


def test_numbers_in_comments_are_not_believed(tmp_path):
    path = tmp_path / "a.gcode"
    head = "; external_perimeter_extrusion_width = 0.8.1\n; slice_thickness = 0.4.4\n; ice_layers = 2\n"
    path.write_text(head + PLAIN)
    assert np.isnan(read(path).layers[0].beads.width).all()


HEAD = '<svg width="{}" viewBox="0 0 50 50" xmlns:slic3r="x"><g slic3r:z="0.2">{}</g></svg>'
SQUARE = 'points="0,0 4,0 4,2 0,2"'


@pytest.mark.parametrize(
    ("shapes", "box"),
    [
        (f'<polygon {SQUARE} transform="translate(3,2)"/>', (3, 2, 7, 4)),
        (f'<polygon {SQUARE} transform="translate(3 2) scale(2)"/>', (3, 2, 11, 6)),
        (f'<polygon {SQUARE} transform="matrix(0,1,-1,0,5,6)"/>', (3, 6, 5, 10)),
        (f'<g transform="scale(2,3)"><polygon {SQUARE} transform="rotate(90)"/></g>', (-4, 0, 0, 12)),
        (f'<polygon {SQUARE}/><polygon points="9,9 8,9 8,8" style="display: none"/>', (0, 0, 4, 2)),
        (f'<polygon {SQUARE}/><g display="none"><polygon points="9,9 8,9 8,8"/></g>', (0, 0, 4, 2)),
        ('<rect x="1" y="2" width="3" height="4"/>', (1, 2, 4, 6)),
        (f'<rect width="50" height="50"/><polygon {SQUARE}/>', (0, 0, 4, 2)),
        (f'<rect width="100%" height="100%"/><polygon {SQUARE}/>', (0, 0, 4, 2)),
    ],
)
def test_shapes_of_svg(shapes, box, tmp_path):
    path = tmp_path / "a.svg"
    path.write_text(HEAD.format("50mm", shapes))
    points = np.concatenate(read(path).layers[0].loops)
    assert [*points.min(axis=0), *points.max(axis=0)] == pytest.approx(box, abs=1e-9)


def test_what_svg_is_refused(tmp_path):
    path = tmp_path / "a.svg"
    path.write_text(HEAD.format("50mm", f'<polygon {SQUARE} transform="skewX(3)"/>'))
    with pytest.raises(RasterSliceError, match=r"a.svg:1: transform skewX"):
        read(path)
    path.write_text(HEAD.format("1.2.3mm", f"<polygon {SQUARE}/>"))
    assert len(read(path).layers) == 1  # a width that says nothing
