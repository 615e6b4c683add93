"""check: what we wrote ourselves is never failed against its own parameter file, and faults in it are found."""

import models
import numpy as np
import pytest
import shapely

from rasterslice.check import readers
from rasterslice.check.pixels import COVERED
from rasterslice.check.run import check
from rasterslice.cli import main
from rasterslice.errors import ModelError

T, PITCH = 0.4, 0.2


def comb(seed, count=14):
    """A plate with tongues and clefts as wide as a pixel or two."""
    rng, edge = np.random.default_rng(seed), []
    for i in range(count):
        x, wide = 2 + 1.7 * i + rng.uniform(0, 0.2), rng.uniform(0.2, 0.45)
        high, lean = rng.uniform(0.25, 0.6) * (1 if i % 2 else -1), rng.uniform(-0.3, 0.3)
        edge += [(x, 8.03), (x + wide / 2 + lean, 8.03 + high), (x + wide, 8.03)]
    end = 1.7 * count + 4
    return models.prism([np.array([(0.0, 0.0), (end, 0.0), (end, 8.03), *edge[::-1], (0.0, 8.03)])], 0.0, 2.0)


def tip(high, off):
    body = models.cone(12.0, high, 64)
    return models.Body(body.vertices + (off, off, 0), body.faces)


def sliced(body, folder, export, **settings):
    mesh = models.write_stl(folder / "part.stl", body.triangles())
    settings = {"scaffolding": 0, "thickness": T, "pitch": PITCH, **settings}
    params = models.write_params(folder, mesh, export=export, **settings)
    assert main([str(params), "--quiet", "-o", str(folder / "run")]) == 0
    return params, folder / "run"


def outputs(run):
    names = {"layers", "layers.csv", "manifest.json", "report.html"}
    return [run, *(path for path in sorted(run.iterdir()) if path.name not in names)]


@pytest.mark.parametrize("seed", range(3))
def test_tongues_that_pixels_lose_accuse_nobody(seed, tmp_path):
    params, run = sliced(comb(seed), tmp_path, "svg, svg-single, npz, png, tiff")
    assert len(outputs(run)) == 6
    for path in outputs(run):
        r = check(params, path)
        assert not r["failed"] and not r["faults"], (path.name, r["worst"][:1])
        assert "pixels explain that" in r["worst"][0]["reasons"] or path.name in ("png", "params.ome.tif")


@pytest.mark.parametrize(("high", "off"), [(6.13, 0.0), (6.17, 0.1), (6.2, 0.1), (12.2, 0.1)])
def test_a_tip_that_is_too_small_for_pixels(high, off, tmp_path):
    params, run = sliced(tip(high, off), tmp_path, "svg, npz, png, tiff", slice_position=0.3)
    for path in outputs(run):
        r = check(params, path)
        assert not r["failed"] and not r["faults"] and r["verdict"] == "pass", (path.name, r["worst"][:1])
        assert len(r["cannot_tell"]) <= 2, path.name


def test_faults_beside_tongues_are_found(tmp_path, monkeypatch):
    """A dent in which a disc finds place is one, in regions as in those of another program."""
    params, run = sliced(comb(0), tmp_path, "svg, npz")
    held, read = run / "params.npz", readers.read
    for deep, due in ((1.6 * COVERED * PITCH, []), (2.6 * COVERED * PITCH, [2])):

        def dented(path, deep=deep):
            dent = shapely.box(10, -1, 10 + deep, deep)
            theirs = read(path)
            shape = shapely.Polygon(theirs.layers[2].loops[0]).difference(dent)
            theirs.layers[2].loops[0] = np.array(shape.exterior.coords)[-2::-1]
            return theirs

        monkeypatch.setattr(readers, "read", dented)
        r = check(params, held)
        assert r["failed"] == due, r["worst"][:1]
        assert 2 in (r["failed"] or r["cannot_tell"])


def test_fill_of_our_scaffold_holds_overhangs(tmp_path):
    """A table top of 24 mm: the rim of the scaffold below it is too far away, its fill is not."""
    body = models.join(models.box((-2, -2, 0), (2, 2, 4)), models.box((-12, -12, 4), (12, 12, 5.2)))
    params, run = sliced(body, tmp_path, "cli, cli-binary", scaffolding=1, widths=(0.8, 0.8))
    for path in outputs(run)[1:]:
        r = check(params, path)
        assert r["verdict"] == "pass" and not r["failed"], (path.name, r["worst"][:1])
        assert any("overhangs less steep" in note for note in r["notes"])
    whole = (run / "params.cli").read_bytes()
    assert b"$$HATCHES/2," in whole
    bare = b"\n".join(line for line in whole.split(b"\n") if not line.startswith(b"$$HATCHES/2,"))
    (tmp_path / "bare.cli").write_bytes(bare)
    assert any("overhang without support" in k["reasons"] for k in check(params, tmp_path / "bare.cli")["worst"])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("$$HATCHES/2,2,0,0,1,1", "$$HATCHES promises 2 lines and has 4 coordinates"),
        ("$$HATCHES/2,1,0,0,1,x", "$$HATCHES: a value must be a number, got 'x'"),
        ("$$HATCHES/2,1,0,0,1,1e9", "a coordinate must lie within"),
    ],
)
def test_damaged_hatches(text, said, tmp_path):
    head = "$$HEADERSTART\n$$ASCII\n$$UNITS/1.0\n$$LABEL/1,part\n$$LABEL/2,scaffold\n$$DIMENSION/0,0,0,1,1,1\n"
    body = "$$LAYERS/000001\n$$HEADEREND\n$$GEOMETRYSTART\n$$LAYER/0.4\n"
    (tmp_path / "a.cli").write_text(head + body + text + "\n$$GEOMETRYEND\n")
    with pytest.raises(ModelError) as caught:
        readers.read(tmp_path / "a.cli")
    assert said in str(caught.value) and "a.cli:11: " in str(caught.value)


def test_contours_of_two_points_in_our_svg(tmp_path):
    params, run = sliced(tip(6.0, 0.0), tmp_path, "svg")
    path = run / "svg" / "layer_0002.svg"
    text = path.read_text()
    at = text.index('d="M', text.index('id="part_region"')) + 3
    path.write_text(text[:at] + "M1.0,1.0L1.2,1.1Z" + text[at:])
    assert check(params, run / "svg")["verdict"] == "pass"


def test_our_own_pictures_say_how_they_lie(tmp_path):
    cv2 = pytest.importorskip("cv2")
    body = models.join(models.box((0, 0, 0), (12, 5, 2)), models.box((8, 5, 0), (12, 9, 2)))
    params, run = sliced(body, tmp_path, "png")
    for path in (run / "png").glob("*.png"):
        whole = path.read_bytes()
        image = cv2.imdecode(np.frombuffer(whole, np.uint8), cv2.IMREAD_GRAYSCALE)
        turned = cv2.imencode(".png", image[:, ::-1])[1].tobytes()
        at = whole.find(b"pHYs") - 4
        path.write_bytes(turned[:33] + whole[at : at + 21] + turned[33:])
    assert check(params, run / "png")["faults"] == ["the file is mirrored in x"]
