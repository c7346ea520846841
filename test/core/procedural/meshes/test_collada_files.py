"""COLLADA files that refer to images elsewhere, or say what Blender leaves out without a word."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from PIL import Image

from oaisys_core.errors import BackendUnavailableError, InvalidInputError
from oaisys_core.files.mesh_formats.collada_texts import ColladaText
from oaisys_core.procedural.meshes.files import load_mesh

TEXT = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="{unit}"/><up_axis>Z_UP</up_axis></asset>
<library_images><image id="i"><init_from>{image}</init_from></image></library_images>
<library_effects><effect id="e"><profile_COMMON>
<newparam sid="su"><surface type="2D"><init_from>i</init_from></surface></newparam>
<newparam sid="sa"><sampler2D><source>su</source></sampler2D></newparam>
<technique sid="c"><lambert><diffuse><texture texture="sa" texcoord="U"/></diffuse></lambert>
</technique></profile_COMMON></effect></library_effects>
<library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>
<library_geometries><geometry id="g"><mesh>
<source id="s"><float_array id="a" count="12">0 0 0 1 0 0 0 1 0 0 0 1</float_array>
<technique_common><accessor source="#a" count="4" stride="{stride}"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<source id="t"><float_array id="ta" count="6">0 0 1 0 0 1</float_array><technique_common>
<accessor source="#ta" count="3" stride="2"><param name="S" type="float"/><param name="T"
type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<{shape} material="M" count="2"><input semantic="VERTEX" source="#v" offset="0"/>
<input semantic="TEXCOORD" source="#t" offset="1" set="0"/><p>{indices}</p></{shape}>
</mesh></geometry></library_geometries><library_visual_scenes><visual_scene id="vs"><node id="n">
<instance_geometry url="#g"><bind_material><technique_common>
<instance_material symbol="M" target="#m"><bind_vertex_input semantic="U"
input_semantic="TEXCOORD" input_set="0"/></instance_material></technique_common></bind_material>
</instance_geometry></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#vs"/></scene></COLLADA>"""

GOOD = "0 0 1 1 2 2  0 0 1 1 3 2"


def write(
    folder: Path,
    *,
    unit: str = "1",
    image: str = "red.png",
    indices: str = GOOD,
    shape: str = "triangles",
    stride: str = "3",
) -> Path:
    """Write a file of two triangles, beside a picture or two."""
    for name in ("red.png", "my red.png"):
        Image.new("RGB", (2, 2), (200, 0, 0)).save(folder / name)
    path = folder / "a.dae"
    text = TEXT.format(unit=unit, image=image, indices=indices, shape=shape, stride=stride)
    path.write_text(text)
    return path


@pytest.mark.blender
@pytest.mark.parametrize(
    "image",
    [
        "../red.png",
        "..%2fred.png",
        "{outside}/red.png",
        "file://{outside}/red.png",
        "file:///C:/red.png",
        "/dev/zero",
        "http://h/red.png",
    ],
)
def test_an_image_elsewhere_is_refused_by_name(tmp_path: Path, image: str) -> None:
    own = tmp_path / "own"
    own.mkdir()
    path = write(own, image=image.format(outside=tmp_path))
    with pytest.raises(InvalidInputError, match="in its own folder or in the asset roots, not"):
        load_mesh(path)


@pytest.mark.blender
@pytest.mark.parametrize(
    ("image", "is_read", "told"),
    [
        ("red.png", True, ""),
        ("./red.png", True, ""),
        ("my%20red.png", True, ""),
        ("file://{folder}/red.png", True, ""),
        ("my red.png", False, "'my red.png' is not read: write its address as a URI, with %20"),
        ("gone.png", False, "'gone.png' is missing"),
    ],
)
def test_an_image_that_is_not_read_is_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, image: str, is_read: bool, told: str
) -> None:
    path = write(tmp_path, image=image.format(folder=tmp_path))
    try:
        mesh = load_mesh(path)
    except BackendUnavailableError:
        pytest.skip("Blender from 5.0 on has no importer of COLLADA")
    assert (mesh.color_image_srgb is not None) == is_read
    assert told in caplog.text
    assert bool(told) == bool(caplog.records)


@pytest.mark.parametrize("shape", ["triangles", "polylist", "polygons", "tristrips", "trifans"])
@pytest.mark.parametrize(
    ("indices", "expected"),
    [
        (GOOD.replace("3", "4"), r"indices of VERTEX from 0 to 3 in <SHAPE>, not 4"),
        (GOOD.replace("3", "-5"), r"indices of VERTEX from 0 to 3 in <SHAPE>, not -5"),
        (GOOD.replace("3", "9" * 30), r"indices of VERTEX from 0 to 3"),
        (GOOD + " 0 0 1 3 2 2", r"indices of TEXCOORD from 0 to 2 in <SHAPE>, not 3"),
        (GOOD.replace("3", "1.5"), "whole numbers as indices"),
    ],
)
def test_indices_of_nothing_are_refused(
    tmp_path: Path, shape: str, indices: str, expected: str
) -> None:
    """Blender drops such a triangle, or all triangles, without a word."""
    ColladaText(write(tmp_path, shape=shape))
    with pytest.raises(ValueError, match=expected.replace("SHAPE", shape)):
        ColladaText(write(tmp_path, shape=shape, indices=indices))


@pytest.mark.blender
def test_an_index_without_a_vertex_is_refused_by_the_files_field(tmp_path: Path) -> None:
    path = write(tmp_path, indices=GOOD.replace("3", "4"))
    with pytest.raises(InvalidInputError, match="from 0 to 3 in <triangles>, not 4") as error:
        load_mesh(path, field="stage.mesh.file")
    assert error.value.field == "stage.mesh.file"


@pytest.mark.parametrize("unit", ["-1", "0", "nan", "inf", "abc", "", "1_0"])
def test_a_unit_that_is_no_length_is_refused(tmp_path: Path, unit: str) -> None:
    with pytest.raises(ValueError, match=f"a meter above 0, not '{unit}'"):
        ColladaText(write(tmp_path, unit=unit))


@pytest.mark.parametrize("stride", ["0", "-1", "x", "9" * 5000])
def test_a_stride_is_a_whole_number(tmp_path: Path, stride: str) -> None:
    with pytest.raises(ValueError, match="stride of 1 or more in <accessor>, not"):
        ColladaText(write(tmp_path, stride=stride))


@pytest.mark.parametrize("encoding", ["gb2312", "unknown"])
def test_encodings_that_are_not_read_are_left_to_blender(tmp_path: Path, encoding: str) -> None:
    path = write(tmp_path)
    head = f'<?xml version="1.0" encoding="{encoding}"?>'
    path.write_text(path.read_text().replace('<?xml version="1.0"?>', head))
    with pytest.raises(ET.ParseError):
        ColladaText(path)
