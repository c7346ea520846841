"""``pip install oaisys-dataset[read]``: small, without Open3D and OpenCV, and it reads."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import venv
from importlib.metadata import requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from repository import REPOSITORY
from small_datasets import SCANNED, render_dataset

from oaisys_dataset import Dataset, open_dataset
from oaisys_dataset.shards import pixels_sha256

LARGEST_MB = 100
"""Of all that is installed, compiled files included, without pip itself."""

HEAVY = {
    *("open3d", "opencv-contrib-python-headless", "rasterio", "scipy", "pyarrow", "ray", "h5py"),
    *("pillow", "openexr", "trimesh", "pyproj", "bpy"),
}
IMPORTED = {
    *("open3d", "cv2", "rasterio", "scipy", "pyarrow", "ray", "h5py", "PIL", "OpenEXR", "trimesh"),
    *(
        "pyproj",
        "yaml",
        "astral",
        "rich",
        "typer",
        "bpy",
        "mlcroissant",
        "pycocotools",
        "webdataset",
    ),
}
"""What the packages behind the other extras are imported as."""

NO_NETWORK = ("NewConnectionError", "ConnectionError", "timed out", "ProxyError", "SSLError")

READ = """\
import json, sys

if {blocked!r}:
    import importlib.abc

    class Absent(importlib.abc.MetaPathFinder):
        def find_spec(self, name, path=None, target=None):
            if name.partition(".")[0] in {blocked!r}:
                raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

    sys.meta_path.insert(0, Absent())
from oaisys_dataset import open_dataset
from oaisys_dataset.shards import pixels_sha256

found = {{}}
dataset = open_dataset({place!r})
for sample in dataset.stream():
    for modality, array in sample.arrays.items():
        found[f"{{sample.record.frame_id}}/{{modality}}"] = pixels_sha256(array)
scans = sum(len(dataset.scan(record).data) for record in dataset.scans)
try:
    dataset.objects(dataset.records[0])
except Exception as error:
    refused = f"{{type(error).__name__}}: {{error}}"
labels = {{str(key): name for key, name in dataset.legend(0).labels.items()}}
print(json.dumps({{"pixels": found, "scans": scans, "labels": labels, "refused": refused}}))
"""


@pytest.fixture(scope="module")
def scanned(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("scanned")
    render_dataset(folder / "set", {0: "train"}, 2, SCANNED)
    return open_dataset(folder / "set")


def judge(dataset: Dataset, python: str, blocked: set[str]) -> None:
    """Read a data set with another interpreter, and compare the pixels."""
    program = READ.format(blocked=sorted(blocked), place=dataset.place.url)
    # Nothing of this environment but what that interpreter has itself.
    kept = {} if blocked == set() else {"PYTHONPATH": os.environ.get("PYTHONPATH", "")}
    result = subprocess.run(
        [python, "-c", program],
        env={"PATH": os.environ["PATH"], **kept},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    read = json.loads(result.stdout)
    wanted = {
        f"{sample.record.frame_id}/{modality}": pixels_sha256(array)
        for sample in dataset
        for modality, array in sample.arrays.items()
    }
    assert read["pixels"] == wanted
    assert read["scans"] == sum(len(dataset.scan(record).data) for record in dataset.scans)
    assert read["labels"] == {str(i): name for i, name in dataset.legend(0).labels.items()}
    assert read["refused"].startswith("ConfigError:")
    assert "oaisys_dataset[objects]" in read["refused"]


def test_the_reader_needs_none_of_the_heavy_packages(scanned: Dataset) -> None:
    judge(scanned, sys.executable, IMPORTED)


def test_the_extra_asks_for_none_of_them() -> None:
    needed, left = set(), {("oaisys-dataset", "read")}
    while left:
        name, extra = left.pop()
        if (name, extra) in needed:
            continue
        needed.add((name, extra))
        for text in requires(name) or ():
            requirement = Requirement(text)
            if requirement.marker is None or requirement.marker.evaluate({"extra": extra}):
                wanted = requirement.name.lower().replace("_", "-")
                left |= {(wanted, each) for each in (requirement.extras or {""})}
    names = {name for name, _ in needed}
    assert "oaisys-core" in names
    assert "numpy" in names
    assert not names & HEAVY


@pytest.mark.long
def test_an_empty_environment_with_the_extra_is_small_and_reads(
    scanned: Dataset, tmp_path: Path
) -> None:
    wheels = built_wheels(tmp_path)
    root = tmp_path / "empty"
    venv.create(root)
    python = str(root / "bin/python")
    pip = [sys.executable, "-m", "pip", "--python", python]
    command = [*pip, "install", "--find-links", str(wheels), "oaisys-dataset[read]"]
    clean = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    installed = subprocess.run(command, env=clean, capture_output=True, text=True, check=False)
    if installed.returncode and any(sign in installed.stderr for sign in NO_NETWORK):
        pytest.skip(f"no package index can be reached: {installed.stderr.strip()[-200:]}")
    assert installed.returncode == 0, installed.stderr
    (packages,) = root.glob("lib/python*/site-packages")
    added = list(packages.iterdir())
    files = [file for path in added for file in (path, *path.rglob("*")) if file.is_file()]
    assert sum(file.stat().st_size for file in files) < LARGEST_MB * 1e6
    names = {path.name.partition("-")[0].lower() for path in added}
    assert not names & {"open3d", "cv2", "bpy"}
    judge(scanned, python, set())


def built_wheels(folder: Path) -> Path:
    """Return a folder with wheels of this repository's packages; the repository is not changed."""
    sources = [folder / "source" / package for package in ("oaisys_core", "oaisys_dataset")]
    for source in sources:
        ignored = shutil.ignore_patterns("__pycache__", "build", "*.egg-info")
        shutil.copytree(REPOSITORY / source.name, source, ignore=ignored)
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation"]
    wheels = folder / "wheels"
    subprocess.run(
        [*command, "--wheel-dir", str(wheels), *map(str, sources)], check=True, capture_output=True
    )
    return wheels
