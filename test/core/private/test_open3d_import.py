"""Open3D and Blender in one process, imported in either order, and tests that need Blender."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest
from blender_process import require_blender
from repository import HELPERS, TESTS

from oaisys_core.private.open3d_import import LIBRARY, Open3DGuard, guard_open3d

OURS = "import oaisys_core"
OPEN3D = "import open3d; open3d.t.geometry.RaycastingScene()"
BLENDER = "import oaisys_core.render.blender; import bpy; bpy.app.version"

MAPPED = f"""
lines = open("/proc/self/maps").read().split()
print(*sorted({{name for name in lines if name.endswith("/{LIBRARY}")}}))
"""


def ran(*lines: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "\n".join(lines)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


@pytest.mark.blender
@pytest.mark.parametrize("order", [(OURS, OPEN3D, BLENDER), (BLENDER, OPEN3D)])
def test_both_are_imported_in_either_order(order: tuple[str, ...]) -> None:
    require_blender()
    ended = ran(*order)
    assert ended.returncode == 0, ended.stderr


@pytest.mark.blender
def test_blenders_library_is_there_before_open3d_looks_for_its_own() -> None:
    require_blender()
    probe = """
import sys
import oaisys_core
class Last:
    def find_spec(self, name, path, target=None):
        if name == "open3d":
            exec(MAPPED)
            sys.exit(0)
names = [type(finder).__name__ for finder in sys.meta_path]
sys.meta_path.insert(names.index("Open3DGuard") + 1, Last())
import open3d
"""
    ended = ran(f"MAPPED = {MAPPED!r}", probe)
    assert ended.returncode == 0, ended.stderr
    assert f"/bpy/lib/{LIBRARY}" in ended.stdout
    assert "open3d" not in ended.stdout


def test_a_process_without_blender_imports_open3d_all_the_same() -> None:
    hidden = """
import sys
class Hidden:
    def find_spec(self, name, path, target=None):
        if name == "bpy":
            raise ModuleNotFoundError("No module named 'bpy'", name="bpy")
sys.meta_path.insert(0, Hidden())
import importlib.util, oaisys_core.private.open3d_import as n
n.find_spec = lambda name: None
"""
    ended = ran(hidden, OPEN3D)
    assert ended.returncode == 0, ended.stderr


def test_open3d_draws_with_plotly_but_imports_it_only_then() -> None:
    draws = """
import sys
import open3d as o3d
assert not {"dash", "plotly"} & set(sys.modules)
figure = o3d.visualization.get_plotly_fig([o3d.geometry.TriangleMesh.create_box()])
assert len(figure.data) == 1
assert callable(sys.modules["open3d.visualization.draw_plotly"].get_point_object)
assert not hasattr(sys.modules["open3d.visualization.draw_plotly"], "nowhere")
"""
    ended = ran(OURS, draws)
    assert ended.returncode == 0, ended.stderr


def test_an_open3d_without_that_module_is_imported_all_the_same() -> None:
    gone = "import oaisys_core.private.open3d_import as n; n.PLOTS = 'open3d.visualization.gone'"
    drawn = "import sys; assert 'open3d.visualization.draw_plotly' in sys.modules"
    ended = ran(gone, OPEN3D, OPEN3D, drawn)
    assert ended.returncode == 0, ended.stderr
    assert ended.stderr.count("Open3D's module that imports Dash cannot be used") == 1


def test_a_machine_without_libusb_uses_that_of_the_package_or_says_what_to_install() -> None:
    """The system's is hidden by another name; the library itself says which one it is."""
    system = "import oaisys_core.private.open3d_import as n; n.LIBUSB = 'libusb-nowhere.so'"
    loaded = "print([line for line in open('/proc/self/maps') if 'libusb' in line])"
    ended = ran(system, "n.load_libusb()", loaded)
    assert "libusb_package/libusb-1.0.so" in ended.stdout
    ended = ran(system, "n.find_spec = lambda name: None", "n.load_libusb()")
    assert "there is no libusb-nowhere.so" in ended.stderr
    assert "pip install libusb-package" in ended.stderr


def test_there_is_one_guard() -> None:
    guard_open3d()
    guard_open3d()
    assert sum(isinstance(finder, Open3DGuard) for finder in sys.meta_path) == 1


def test_a_blender_that_cannot_be_imported_fails_a_test_instead_of_skipping_it(
    tmp_path: Path,
) -> None:
    (tmp_path / "bpy").mkdir()
    (tmp_path / "bpy" / "__init__.py").write_text("raise ImportError('undefined symbol')\n")
    text = f"import sys; sys.path[:0] = [{str(tmp_path)!r}, {str(HELPERS)!r}]\n"
    ended = ran(text + "from blender_process import require_blender; require_blender()")
    assert ended.returncode != 0
    assert "ImportError: undefined symbol" in ended.stderr


def test_no_test_skips_where_a_module_is_installed_but_cannot_be_imported() -> None:
    """`importorskip` takes any error of an import for a module that is not installed."""
    for path in TESTS.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "importorskip":
                told = {each.arg: ast.unparse(each.value) for each in node.keywords}
                assert told.get("exc_type") == "ModuleNotFoundError", f"{path}:{node.lineno}"
                named = [each.value for each in node.args if isinstance(each, ast.Constant)]
                assert "bpy" not in named, f"{path}: needs_blender does it"
