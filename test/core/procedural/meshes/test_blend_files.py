"""Files of Blender from outside: read to their end, and nothing else is read."""

from __future__ import annotations

import signal
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import psutil
import pytest
from blender_process import in_blender

from oaisys_core.errors import CancelledError, InvalidInputError
from oaisys_core.files.path_fields import AssetRoots, confine_paths
from oaisys_core.procedural.meshes import blender_files
from oaisys_core.procedural.meshes.files import load_mesh
from oaisys_core.system.ending.interruption import interruptible

USD = """#usda 1.0
(
    upAxis = "Z"
    {above}
)
def Mesh "own"
{{
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points = [(0, 0, 0), (4, 0, 0), (0, 4, 0)]
}}
def "other" (
    {of_prim}
)
{{
}}
"""

ACCESS = """
import sys
from pathlib import Path
from oaisys_core.files.access_limits import limit_access
import socket
top = Path(sys.argv[1])
if not limit_access([top / "root"], top / "out"):
    raise SystemExit("none")
print((top / "root/inside").read_text())
(top / "out/new").write_text("x")
for attempt in (
    lambda: (top / "secret").read_text(),
    lambda: (top / "root/link").read_text(),
    lambda: Path("/etc/passwd").read_text(),
    lambda: (top / "root/new").write_text("x"),
    lambda: list(top.iterdir()),
):
    try:
        print("done", attempt())
    except PermissionError:
        print("refused")
"""


HUGE_PX = 20_000


def huge_png(size_px: int = HUGE_PX) -> bytes:
    """A PNG of 50 KB: 400 million pixels of one bit, all black."""
    header = struct.pack(">IIBBBBB", size_px, size_px, 1, 0, 0, 0, 0)
    rows = zlib.compress(bytes((1 + size_px // 8) * size_px))
    parts = ((b"IHDR", header), (b"IDAT", rows), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        for name, data in parts
    )


def huge_exr() -> bytes:
    """An EXR file without pixels whose windows are huge."""

    def attribute(name: str, kind: str, data: bytes) -> bytes:
        head = f"{name}\0{kind}\0".encode()
        return head + struct.pack("<i", len(data)) + data

    channel = b"Y\0" + struct.pack("<iiii", 1, 0, 1, 1)
    window = struct.pack("<4i", 0, 0, HUGE_PX - 1, HUGE_PX - 1)
    return b"\x76\x2f\x31\x01\x02\0\0\0" + b"".join(
        (
            attribute("channels", "chlist", channel + b"\0"),
            attribute("compression", "compression", b"\3"),
            attribute("dataWindow", "box2i", window),
            attribute("displayWindow", "box2i", window),
            attribute("lineOrder", "lineOrder", b"\0"),
            attribute("pixelAspectRatio", "float", struct.pack("<f", 1)),
            attribute("screenWindowCenter", "v2f", bytes(8)),
            attribute("screenWindowWidth", "float", struct.pack("<f", 1)),
            b"\0",
            struct.pack("<Q", 0) * -(-HUGE_PX // 16),
        )
    )


HUGE = {
    "png": huge_png,
    "exr": huge_exr,
    "hdr": lambda: (
        f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {HUGE_PX} +X {HUGE_PX}\n".encode() + bytes(100)
    ),
}
"""Images that are small as files and huge in memory, by their suffixes."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    top = tmp_path_factory.mktemp("blend")
    for name in ("root", "outside"):
        (top / name).mkdir()
    in_blender("files.save_linked_blends", str(top))
    return top


@pytest.mark.blender
def test_a_file_with_a_driver_is_read(folder: Path) -> None:
    """Its reader hung at its end, in Blender's own destructors."""
    assert len(load_mesh(folder / "root" / "driver.blend").triangles) == 12


@pytest.mark.blender
@pytest.mark.parametrize(
    ("expression", "factor", "warned"),
    [
        ("len('abcd')", 3.0, 2),
        ("[1 for _ in iter(int, 1)]", 3.0, 2),
        ("frame * 0 + 2", 2.0, 0),
    ],
)
def test_what_a_driver_of_python_drives_stays_as_it_is_saved(
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    expression: str,
    factor: float,
    warned: int,
) -> None:
    """Blender takes 0 for scripts that it may not run: the cube was flat, without a word."""
    in_blender("files.save_driven_blend", str(tmp_path / "cube.blend"), expression)
    mesh = load_mesh(tmp_path / "cube.blend")
    size_m = np.ptp(mesh.vertices_m, axis=0)
    np.testing.assert_allclose(size_m, (2 * factor, 2 * (1 + factor), 2), rtol=1e-6)
    assert caplog.text.count("is not run: the saved value stays") == warned


@pytest.mark.blender
def test_surfaces_of_a_file_that_are_not_read_are_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    in_blender("files.save_instances", str(tmp_path / "scene.blend"))
    assert len(load_mesh(tmp_path / "scene.blend").triangles) == 12
    told = [record.getMessage() for record in caplog.records]
    assert len(told) == 2
    assert "'Text' is left out: a font is no mesh" in told[0]
    assert "what 'again' shows as instances is left out" in told[1]
    caplog.clear()
    assert len(load_mesh(tmp_path / "scene.blend", "Cube").triangles) == 12
    assert not caplog.records


@pytest.mark.blender
@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("image_outside", "secret.png"),
        ("library", "library.blend"),
        ("cache", "cache.pc2"),
        ("reading_node", "Import Text"),
        ("bake", "bake"),
    ],
)
def test_a_file_that_refers_to_others_elsewhere_is_refused_by_name(
    folder: Path, kind: str, name: str
) -> None:
    with pytest.raises(InvalidInputError, match=f"own folder or in the asset roots.*{name}"):
        load_mesh(folder / "root" / f"{kind}.blend")


@pytest.mark.blender
def test_an_ocean_without_a_cache_refers_to_no_file(tmp_path: Path) -> None:
    """Its path is by default in the temporary folder of whoever saved the file."""
    in_blender("files.save_ocean", str(tmp_path / "ocean.blend"))
    assert len(load_mesh(tmp_path / "ocean.blend").triangles) == 2 * 16**2


@pytest.mark.blender
def test_files_beside_it_and_in_the_asset_roots_are_read(folder: Path) -> None:
    assert load_mesh(folder / "root" / "image_inside.blend").color_image_srgb is not None
    with confine_paths(AssetRoots((folder / "root", folder / "outside"))):
        mesh = load_mesh(folder / "root" / "image_outside.blend")
    assert mesh.color_image_srgb is not None


@pytest.mark.blender
def test_a_file_that_takes_too_long_is_given_up_and_then_refused_at_once(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = psutil.Process().children()
    monkeypatch.setattr(blender_files, "BLEND_REQUEST_TIMEOUT_S", 0.1)
    file = folder / "root" / "slow.blend"
    file.write_bytes((folder / "root" / "driver.blend").read_bytes())
    with confine_paths(AssetRoots((folder / "root",))):
        with pytest.raises(InvalidInputError, match=r"loads within 0\.1 s"):
            load_mesh(file)
        assert psutil.Process().children() == before
        monkeypatch.setattr(blender_files, "BLEND_REQUEST_TIMEOUT_S", 60.0)
        with pytest.raises(InvalidInputError, match=r"loads within 0\.1 s"):
            load_mesh(file)


def test_a_file_whose_reader_is_ended_late_is_then_refused_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each view that asked for it again held everybody else up for as long again."""
    codes = iter([-signal.SIGSEGV, -signal.SIGSEGV])
    monkeypatch.setattr(blender_files, "_code_of", lambda *_: next(codes))
    file = tmp_path / "grows.blend"
    file.write_bytes(b"BLENDER")
    expected = "its reader, which may take 8000000000 bytes, was ended by SIGSEGV"
    for slow_s in (60.0, 0.0, 60.0, 60.0):  # one of each number of seconds calls a reader
        monkeypatch.setattr(blender_files, "SLOW_S", slow_s)
        with pytest.raises(InvalidInputError, match=expected):
            load_mesh(file)
    monkeypatch.setattr(blender_files, "_code_of", lambda *_: 1)
    file.write_bytes(b"BLENDER, changed")
    with pytest.raises(InvalidInputError, match="no message"):
        load_mesh(file)


@pytest.mark.blender
@pytest.mark.parametrize("kind", ["png", "exr", "hdr", ""])
def test_an_image_in_a_file_is_refused_before_it_is_decoded(
    tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Blender decodes an image, 4 bytes or floats a pixel, before it tells how large it is."""
    monkeypatch.setattr(blender_files, "READER_MEMORY_BYTES", 1_000_000_000)
    image = tmp_path / f"huge.{kind}"
    if kind:
        image.write_bytes(HUGE[kind]())
    blend = tmp_path / "cube.blend"
    in_blender("files.save_blend_with_image", str(blend), str(image) if kind else "")
    with pytest.raises(InvalidInputError, match="at most 67108864 pixels, not 20000 x 20000"):
        load_mesh(blend)


@pytest.mark.blender
@pytest.mark.parametrize("use", ["colour", "displacement"])
def test_images_in_a_file_are_refused_together_before_they_are_decoded(
    tmp_path: Path, use: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """300 images within the bound of each took 4 GB; what displaces was not looked at at all."""
    monkeypatch.setattr(blender_files, "READER_MEMORY_BYTES", 1_000_000_000)
    (tmp_path / "image.png").write_bytes(huge_png(8000))
    blend = tmp_path / "cube.blend"
    job = "files.save_blend_of_many_images"
    in_blender(job, str(blend), str(tmp_path / "image.png"), 9, use)
    with pytest.raises(InvalidInputError, match="at most 536870912 pixels together, not 576000000"):
        load_mesh(blend)


FITTED = {"fit_type": "FIT_LENGTH", "use_constant_offset": True, "use_relative_offset": False}


@pytest.mark.blender
@pytest.mark.parametrize(
    ("arrays", "triangles"),
    [
        ([{"count": 1000}] * 4, 12 * 1000**4),
        ([{"count": 2**31 - 1}] * 500, 10**18),
        ([FITTED | {"fit_length": 2048, "constant_offset_displace": (2**-10, 0, 0)}], 25_165_836),
        ([{"fit_type": "FIT_LENGTH", "fit_length": 4e6}], 24_000_012),
    ],
)
def test_arrays_are_counted_before_they_are_made(
    tmp_path: Path, arrays: list[dict[str, object]], triangles: int
) -> None:
    """A cube with 84 KB of file took its reader 15 s and 1.7 GB, or was one cube without a word."""
    in_blender("files.save_blend_of_arrays", str(tmp_path / "cube.blend"), arrays)
    expected = f"at most 20000000 triangles, not {triangles + 12}, most of them of 'copied'"
    with pytest.raises(InvalidInputError, match=expected):
        load_mesh(tmp_path / "cube.blend")
    assert len(load_mesh(tmp_path / "cube.blend", "plain").triangles) == 12


@pytest.mark.blender
def test_modifiers_that_blender_leaves_out_are_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    arrays = [{"count": 5}, FITTED | {"fit_length": 1e9, "constant_offset_displace": (1e-7, 0, 0)}]
    in_blender("files.save_blend_of_arrays", str(tmp_path / "cube.blend"), arrays)
    assert len(load_mesh(tmp_path / "cube.blend", "copied").triangles) == 5 * 12
    assert caplog.text.count("leaves out the modifier 'array.001' of 'copied': The offset is") == 1
    caplog.clear()
    assert len(load_mesh(tmp_path / "cube.blend", "plain").triangles) == 12
    assert not caplog.records


@pytest.mark.blender
@pytest.mark.parametrize(("name", "shown"), [("scale", "scale"), ("location", "position")])
def test_an_object_that_is_nowhere_is_named(tmp_path: Path, name: str, shown: str) -> None:
    """NumPy's own error was told, of a matrix whose singular values do not converge."""
    in_blender("files.save_blend_placed_nowhere", str(tmp_path / "cube.blend"), name)
    expected = rf"positions, rotations and scales, unlike those of 'Cube' .*{shown} \(nan"
    with pytest.raises(InvalidInputError, match=expected):
        load_mesh(tmp_path / "cube.blend")


@pytest.mark.blender
def test_a_wait_for_a_reader_can_be_cancelled(folder: Path) -> None:
    asked, before = 0, psutil.Process().children()

    def check() -> None:
        nonlocal asked
        asked += 1
        if asked > 2:
            raise CancelledError("by its owner")

    with interruptible(check), pytest.raises(CancelledError):
        load_mesh(folder / "root" / "driver.blend")
    assert psutil.Process().children() == before


def test_a_reader_can_open_nothing_elsewhere(tmp_path: Path) -> None:
    for name in ("root", "out"):
        (tmp_path / name).mkdir()
    (tmp_path / "root/inside").write_text("inside")
    (tmp_path / "secret").write_text("secret")
    (tmp_path / "root/link").symlink_to(tmp_path / "secret")
    command = [sys.executable, "-c", ACCESS, str(tmp_path)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    if "none" in ended.stderr:
        pytest.skip("this kernel has no Landlock")
    assert ended.stdout.split() == ["inside", *["refused"] * 5], ended.stderr


@pytest.mark.blender
@pytest.mark.parametrize(
    ("line", "name"),
    [
        ("references = @{}@</own>", "../other.usda"),
        ("references = @{}@</own>", "{top}/other.usda"),
        ("references = @{}@</own>", "link.usda"),
        ("references = @between.usda@</own>", "http://h/o.usda"),
        ("payload = @{}@</own>", "../other.usda"),
        ("subLayers = [@{}@]", "{top}/other.usda"),
        ("clips = {{ dictionary default = {{ asset[] assetPaths = [@{}@] }} }}", "link.usda"),
    ],
)
def test_a_usd_file_that_refers_to_others_elsewhere_is_refused_by_name(
    tmp_path: Path, line: str, name: str
) -> None:
    """What lies elsewhere was left out without a word, or read where the kernel has no Landlock."""
    own = tmp_path / "own"
    own.mkdir()
    (tmp_path / "other.usda").write_text(USD.format(above="", of_prim=""))
    (own / "link.usda").symlink_to(tmp_path / "other.usda")
    name = name.format(top=tmp_path)
    between = USD.format(above="", of_prim=f"references = @{name}@</own>")
    (own / "between.usda").write_text(between)
    place = "above" if line.startswith("sub") else "of_prim"
    lines = {"above": "", "of_prim": "", place: line.format(name)}
    (own / "world.usda").write_text(USD.format(**lines))
    with pytest.raises(InvalidInputError, match="in its own folder or in the asset roots") as error:
        load_mesh(own / "world.usda")
    # Of a long path, the beginning and the end are shown.
    assert name.rpartition("/")[2] in str(error.value)


@pytest.mark.blender
@pytest.mark.parametrize("unit", ["-1", "0", "nan", "inf"])
def test_a_usd_file_with_a_unit_that_is_no_length_is_refused(tmp_path: Path, unit: str) -> None:
    text = USD.format(above=f"metersPerUnit = {unit}", of_prim="")
    (tmp_path / "world.usda").write_text(text)
    with pytest.raises(InvalidInputError, match=f"a metersPerUnit above 0, not {unit}"):
        load_mesh(tmp_path / "world.usda")


@pytest.mark.blender
def test_points_that_are_no_numbers_are_told_as_such(tmp_path: Path) -> None:
    """They differ from themselves, which was taken for a shape that is drawn anew."""
    text = USD.format(above="", of_prim="").replace("(4, 0, 0)", "(nan, inf, 0)")
    (tmp_path / "world.usda").write_text(text)
    with pytest.raises(InvalidInputError, match="finite coordinates of at most 1e"):
        load_mesh(tmp_path / "world.usda")


@pytest.mark.blender
def test_layers_beside_a_usd_file_are_read_and_missing_ones_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "other.usda").write_text(USD.format(above="", of_prim=""))
    for name, triangles in (("other.usda", 2), ("gone.usda", 1)):
        text = USD.format(above="", of_prim=f"references = @{name}@</own>")
        (tmp_path / "world.usda").write_text(text)
        assert len(load_mesh(tmp_path / "world.usda").triangles) == triangles
        assert ("'gone.usda' is missing" in caplog.text) == (name == "gone.usda")
