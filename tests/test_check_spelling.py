"""check: G-code in other legal spellings, SVG with transforms and hidden shapes, malformed numbers."""

import numpy as np
import pytest

from rasterslice.check import gcode_text
from rasterslice.check.form import FILL, WALL
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


@pytest.mark.parametrize(
    ("comment", "said"),
    [
        (";WIDTH:abc", "a width must be a number, got 'abc'"),
        ("; LINE_WIDTH: 0.4.5", "a width must be a number, got '0.4.5'"),
        (";WIDTH:nan", "a width must lie within"),
        (";WIDTH:-0.4", "a width must be 0 to 100 mm, got -0.4"),
        ("; external perimeters extrusion width = zz", "perimeters extrusion width must be a number, got 'zz'"),
        ("; external perimeters extrusion width = mm", "perimeters extrusion width must be a number, got ''"),
        ("; external_perimeter_extrusion_width = 0.8.1", "must be a number, got '0.8.1'"),
        ("; external_perimeter_extrusion_width = x%", "must be a number, got 'x'"),
        ("; outer_wall_line_width = ", "outer_wall_line_width must be a number, got ''"),
        ("; outer_wall_line_width = 420", "outer_wall_line_width must be 0 to 100 mm, got 420"),
        ("; filament_diameter = 1.75,fat", "filament_diameter must be a number, got 'fat'"),
        (";LAYER:two", "the number of a layer must be whole, got 'two'"),
        ("; slice_thickness = 0.4.4", "slice_thickness must be a number, got '0.4.4'"),
        ("; ice_layers = x", "ice_layers must be a number, got 'x'"),
    ],
)
def test_malformed_numbers_in_comments_name_their_line(comment, said, tmp_path):
    path = tmp_path / "a.gcode"
    path.write_text("; a file\n" + comment + "\n" + PLAIN)
    with pytest.raises(RasterSliceError) as caught:
        read(path)
    assert "a.gcode:2: " in str(caught.value) and said in str(caught.value)


@pytest.mark.parametrize(
    ("comment", "width"),
    [
        ("; external perimeters extrusion width = 0.60mm (1.90mm^3/s)", 0.6),
        ("; external perimeters extrusion width = 1.50mm", 1.5),
        ("; external_perimeter_extrusion_width = 0", np.nan),  # the program's own choice
        ("; external_perimeter_extrusion_width = 105%", np.nan),  # of a nozzle that is not read
        ("; external_perimeter_extrusion_width = 105%\n; external perimeters extrusion width = 0.47mm", 0.47),
        ("; outer_wall_line_width = 0.42\n; filament_diameter = 1.75,1.75", 0.42),
        ("; support_material_extrusion_width = wide", np.nan),  # not read
        (";WIDTH:0.7\n; external_perimeter_extrusion_width = 0.6", 0.7),
    ],
)
def test_widths_in_comments(comment, width, tmp_path):
    path = tmp_path / "a.gcode"
    path.write_text(comment + "\n" + PLAIN)
    assert read(path).layers[0].beads.width.tolist() == pytest.approx([width], nan_ok=True)


@pytest.mark.parametrize("way", [str, *SPELLED.values()], ids=["plain", *SPELLED])
@pytest.mark.parametrize("block", [1, 7, 40])
def test_blocks_do_not_matter(way, block, tmp_path, monkeypatch):
    path = tmp_path / "a.gcode"
    path.write_text(way(PLAIN + ";LAYER_CHANGE\nG1 Z.8 F900\nG0 X9 Y9 F50\n\nG1 X8 E9.606 ; on\n" + "G1 Y8 E10.606"))
    whole = read(path)
    monkeypatch.setattr(gcode_text, "BLOCK", block)
    cut = read(path)
    assert [k.where for k in cut.layers] == [k.where for k in whole.layers] == ["line 1", "line 9"]
    for a, b in zip(whole.layers, cut.layers, strict=True):
        assert a.beads.points.tolist() == b.beads.points.tolist()
    assert whole.layers[1].beads.points.tolist() == [[9, 9], [8, 9], [8, 8]]


def test_remarks_behind_moves(tmp_path):
    """As Slic3r writes them when it is asked to: kinds of beads, and those that are no part."""
    path = tmp_path / "a.gcode"
    moves = ["G1 X1 Y0 E1 ; skirt", "G1 X2 E2 ; perimeter", "G1X3E3;perimeter"]
    moves += ["G1 X4 E4 ; infill (2)", "G1 X5 E5 ; move on"]
    path.write_text("G1 Z.4 ; up\nG1 X0 Y0\n" + "\n".join(moves) + "\n")
    beads = read(path).layers[0].beads
    assert beads.role.tolist() == [WALL, FILL]
    assert beads.points.tolist() == [[1, 0], [2, 0], [3, 0], [3, 0], [4, 0], [5, 0]]
    assert beads.offsets.tolist() == [0, 3, 6]


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
