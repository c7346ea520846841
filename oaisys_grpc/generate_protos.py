"""Generate the Python code of every ``.proto`` file below ``proto/`` into ``oaisys_grpc/pb/``.

``proto/oaisys/v1/simulator.proto`` becomes ``oaisys_grpc.pb.oaisys.v1.simulator_pb2`` and
``..._pb2_grpc``, with type stubs where ``mypy-protobuf`` is installed. `make setup`, pip and colcon
run this; nobody needs to. Nothing is done where the generated code is up to date.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.resources
import importlib.util
import re
import shutil
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
PROTO_ROOT = HERE / "proto"
OUTPUT = HERE / "oaisys_grpc" / "pb"
PACKAGE = "oaisys_grpc.pb"


def main() -> int:
    """Generate what is out of date; return the exit code."""
    protos = sorted(PROTO_ROOT.rglob("*.proto"))
    key = _key(protos)
    stamp = OUTPUT / "sources.sha256"
    if stamp.is_file() and stamp.read_text() == key:
        return 0
    with tempfile.TemporaryDirectory(dir=HERE, prefix=".pb-") as folder:
        output = Path(folder, "pb")
        output.mkdir()
        if protos and not _compile(protos, output):
            return 1
        _rewrite_imports(protos, output)
        for package in {output, *(file.parent for file in output.rglob("*.py"))}:
            for parent in (package, *package.parents):
                (parent / "__init__.py").touch()
                if parent == output:
                    break
        (output / stamp.name).write_text(key)
        shutil.rmtree(OUTPUT, ignore_errors=True)
        output.rename(OUTPUT)
    return 0


def _key(protos: list[Path]) -> str:
    state = hashlib.sha256(Path(__file__).read_bytes())
    for proto in protos:
        state.update(str(proto.relative_to(PROTO_ROOT)).encode() + b"\0")
        state.update(proto.read_bytes())
    return state.hexdigest()


def _compile(protos: list[Path], output: Path) -> bool:
    """Run protoc, which reports its errors itself."""
    from grpc_tools import protoc

    arguments = ["protoc", f"--proto_path={PROTO_ROOT}"]
    arguments += [f"--proto_path={importlib.resources.files('grpc_tools') / '_proto'}"]
    arguments += [f"--python_out={output}", f"--grpc_python_out={output}"]
    plugins = {name: Path(sys.executable).with_name(name) for name in _STUB_PLUGINS}
    if importlib.util.find_spec("mypy_protobuf") and all(map(Path.is_file, plugins.values())):
        arguments += [f"--plugin={name}={path}" for name, path in plugins.items()]
        arguments += [f"--mypy_out=quiet:{output}", f"--mypy_grpc_out=quiet:{output}"]
    return protoc.main([*arguments, *map(str, protos)]) == 0


_STUB_PLUGINS = ("protoc-gen-mypy", "protoc-gen-mypy_grpc")


def _rewrite_imports(protos: list[Path], output: Path) -> None:
    """Make generated modules import each other from where they are.

    protoc derives module names from the paths of the ``.proto`` files alone.
    """
    for folder in {proto.parent.relative_to(PROTO_ROOT) for proto in protos}:
        names = "|".join(p.stem for p in protos if p.parent == PROTO_ROOT / folder)
        package = ".".join(folder.parts)
        if package:
            pattern = re.compile(rf"^(\s*)from {re.escape(package)} import ((?:{names})_pb2)", re.M)
            replacement = rf"\1from {PACKAGE}.{package} import \2"
        else:
            pattern = re.compile(rf"^(\s*)import ((?:{names})_pb2)\b", re.M)
            replacement = rf"\1from {PACKAGE} import \2"
        for file in (*output.rglob("*.py"), *output.rglob("*.pyi")):
            file.write_text(pattern.sub(replacement, file.read_text()))


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    sys.exit(main())
