"""check: what lines of G-code do beside plain moves; what changes places is followed, or refused with its line."""

import numpy as np
import pytest

from rasterslice.check.readers import read
from rasterslice.errors import RasterSliceError

HEAD = ";LAYER_CHANGE\nG1 Z.4\n;TYPE:External perimeter\nM83\nG1 X1 Y2\n"
PLAIN = HEAD + "G1 X3 Y2 E2\nG1 X3 Y5 E3\nG1 X1 Y2 E3.6\n"
CORNERS = [[1, 2], [3, 2], [3, 5], [1, 2]]


def gcode(tmp_path, text):
    path = tmp_path / "a.gcode"
    path.write_text(text)
    return path


def beads(tmp_path, text):
    return read(gcode(tmp_path, text)).layers[0].beads


FOLLOWED = {
    "modal": "G1 X3 Y2 E2\nX3 Y5 E3\nX1 Y2 E3.6\n",
    "modal, one axis": "G1 X3 E2\nY5 E3\nX1 Y2 E3.6\n",
    "modal, small and together": "G1 X3 Y2 E2\nx3y5e3\nx1y2e3.6\n",
    "modal, numbered": "N4 G1 X3 Y2 E2\nN5 X3 Y5 E3*31\nN6 X1 (home) Y2 E3.6\n",
    "modal after a speed": "G1 X3 Y2 E2\nG1 F900\nX3 Y5 E3\nF800\nX1 Y2 E3.6\n",
    "modal after a mode": "G1 X3 Y2 E2\nM83\nX3 Y5 E3\nM204 X100\nX1 Y2 E3.6\n",
    "modal after a quick move": "G0 X1 Y2\nX3 Y2 E2\nX3 Y5 E3\nX1 Y2 E3.6\n",
    "mode and move": "G91 G1 X2 E2\nG90 M83 G1 Y5 E3\nG90 M83 X1 Y2 E3.6\n",
    "unit and move": "G20 G1 X.11811023622047244 Y.07874015748031496 E2\nG21 G01 X3 Y5 E3\nX1 Y2 E3.6\n",
    "no bead": "G4 P100\nG10\nG11\nG17\nG92 E0\nG54\nM204 X500\nT0\nG1 X3 Y2 E2\nG1 X3 Y5 E3\nG1 X1 Y2 E3.6\n",
    "homed, and told": "G28 W\nG29.1 Z{+0.00}\nG1 X1 Y2 Z.4\nG1 X3 Y2 E2\nG1 X3 Y5 E3\nG1 X1 Y2 E3.6\n",
    "texts": "M117 G1 X9 E9\nM862.3 P \"MK3S\"\nM486 Abox\nG1 X3 Y2 E2\nG1 X3 Y5 E3\nG1 X1 Y2 E3.6\n",
    "byte order": None,
}  # fmt: skip


@pytest.mark.parametrize("way", FOLLOWED)
def test_what_is_followed(way, tmp_path):
    text = "\ufeff" + PLAIN if FOLLOWED[way] is None else HEAD + FOLLOWED[way]
    found = beads(tmp_path, text)
    np.testing.assert_allclose(found.points, CORNERS, atol=1e-12)
    assert beads(tmp_path, PLAIN).points.tolist() == CORNERS


def test_arcs_go_on(tmp_path):
    arcs = beads(tmp_path, HEAD + "G2 X3 Y2 I1 J0 E2\nG2 X1 Y2 I-1 J0 E2\n")
    modal = beads(tmp_path, HEAD + "G2 X3 Y2 I1 J0 K0 P1 E2\nX1 Y2 I-1 J0 E2\n")
    assert modal.points.tolist() == arcs.points.tolist() and len(arcs.points) > 20
    straight = beads(tmp_path, HEAD + "G2 X3 Y2 I1 J0 E2\nG1 F900\nX1 Y5 E2\n")
    assert straight.points[-2:].tolist() == [[3, 2], [1, 5]]


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("G55", "G55 is not built yet: it may move what follows"),
        ("G53 G1 X5 E1", "G53 is not built yet"),
        ("g52 X4", "G52 is not built yet"),
        ("N7 G90.1", "G90.1 is not built yet"),
        ("G19", "G19 is not built yet"),
        ("G90 G18", "G18 is not built yet"),
        ("G42 D1", "G42 is not built yet"),
        ("G51 X2", "G51 is not built yet"),
        ("G68 R45", "G68 is not built yet"),
        ("G5 X1 Y1 I1 J1 P1 Q1", "G5 is not built yet"),
        ("G10 L2 P1 X5", "G10 is not built yet"),
        ("M206 X5", "M206 moves or bends the frame"),
        ("G92", "G92 moves the frame"),
        ("G90 G92 X0", "G92 moves the frame"),
        ("G92.3", "G92.3 is not built yet"),
        ("G1 X5 U2 E1", "U in a move is not built yet"),
        ("G1 X5 A2", "A in a move is not built yet"),
        ("G1 X5 I2 E1", "I in a move is not built yet"),
        ("G2 X5 I2 K1 E1", "K in a move is not built yet"),
        ("G2 X5 I2 P3 E1", "P in a move is not built yet"),
        ("G1 X5 E1 G1 X6 E1", "G1 and G1 in one line"),
        ("G28 G1 X6 E1", "G28 and G1 in one line"),
        ("M83 G1 Xten", "X must be a number, got 'ten'"),
        ("X5 Yten", "Y must be a number, got 'ten'"),
        ("X5 ?", "is no word of G-code"),
        ("?? X5", "is no command of G-code"),
        ("/G1 X5 E1", "is no command of G-code"),
        ("$H", "is no command of G-code"),
        ("g1 x5e-12", "is ambiguous"),
    ],
)
def test_what_changes_places_is_refused_with_its_line(line, said, tmp_path):
    with pytest.raises(RasterSliceError) as caught:
        read(gcode(tmp_path, PLAIN + line + "\nG1 X9 E1\n"))
    assert "a.gcode:9: " in str(caught.value) and said in str(caught.value)


def test_coordinates_before_any_command(tmp_path):
    with pytest.raises(RasterSliceError, match=r"a.gcode:2: coordinates before any of G0, G1, G2 and G3"):
        read(gcode(tmp_path, "G90\nX1 Y1\n" + PLAIN))


@pytest.mark.parametrize("away", ["G28", "G28 Y0", "G29", "G91\nG28 Y\nG1 Y5\nG90\nM83", "G27", "G61"])
def test_beads_from_an_unknown_place_are_refused(away, tmp_path):
    line = 8 + len(away.split("\n")) + 1
    with pytest.raises(RasterSliceError, match=rf"a.gcode:{line}: a bead begins where homing"):
        read(gcode(tmp_path, PLAIN + away + "\nG1 X3 E1\n"))
    read(gcode(tmp_path, PLAIN + away + "\nG1 X3 Y2 Z.4\nG1 X5 E1\n"))
    read(gcode(tmp_path, PLAIN + away + "\n"))


def test_where_printers_disagree_about_e(tmp_path):
    with pytest.raises(RasterSliceError, match=r"a.gcode:10: printers disagree whether G90 and G91 are about E, too"):
        read(gcode(tmp_path, PLAIN + "G90\nG1 X5 E1\nG1 X6 E1\n"))  # M83 was said before
    read(gcode(tmp_path, PLAIN + "G90\nM83\nG1 X5 E1\nG1 X6 E1\n"))
    end = "M82\nG92 E9\nG91\nG1 Z+0.5 E-5 X-20 Y-20 F9000\nG90\n"  # as Cura ends: no printer lays a bead
    assert beads(tmp_path, PLAIN + end).points.tolist() == CORNERS


def test_e_goes_on_after_relative_moves(tmp_path):
    """What is fed after a way back by relative E counts from there, not from the last number."""
    moves = "G1 X3 Y2 E4\nG91\nG1 E-2\nG90\nG1 X3 Y5 E8\n"
    found = beads(tmp_path, HEAD.replace("M83", "M82").replace("External perimeter", "Perimeter") + moves)
    assert found.fed.tolist() == pytest.approx([2])


def test_macros_are_named(tmp_path):
    start = "START_PRINT BED=60\nEXCLUDE_OBJECT_START NAME=box\n@pause\n"
    found = read(gcode(tmp_path, start + PLAIN))
    assert any("line 1, 'START_PRINT BED=60', and 2 more" in note for note in found.notes)
    assert found.layers[0].beads.points.tolist() == CORNERS


def test_unknown_kinds_of_beads_are_said(tmp_path):
    found = read(gcode(tmp_path, PLAIN + ";TYPE:Wall-Inside\nG1 X1 Y1 E4\n"))
    assert any("not known were left out: 'Wall-Inside' (line 9)" in note for note in found.notes)
    for aside in ("Skirt", "Skirt/Brim", "Custom", "PRIME-TOWER", "Wipe tower"):
        assert not read(gcode(tmp_path, PLAIN + f";TYPE:{aside}\nG1 X1 Y1 E4\n")).notes


def test_without_a_known_outer_wall_the_names_are_said(tmp_path):
    inner = ";TYPE:Perimeter\nG1 X1 Y1 E4\n"
    with pytest.raises(RasterSliceError, match=r"a.gcode:3: no outer wall is known.*'Wall-Outside' \(line 3\)"):
        read(gcode(tmp_path, PLAIN.replace("External perimeter", "Wall-Outside") + inner))
    with pytest.raises(RasterSliceError, match=r"a.gcode:1: the file extrudes.*no line ;TYPE: or ;FEATURE:"):
        read(gcode(tmp_path, PLAIN.replace(";TYPE:External perimeter\n", "")))
