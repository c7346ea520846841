"""The page of the gRPC contract, from the proto file and its comments."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorSet

from oaisys_core.system.python_programs import python_command
from tools.programs import ROOT

FOLDER = ROOT / "oaisys_grpc" / "proto"
FILE = "oaisys/v1/simulator.proto"
SERVICE, MESSAGE, ENUM, SYNTAX = 6, 4, 5, 12
"""Numbers of these fields of `FileDescriptorProto`, by which comments are found."""

Comments = Mapping[tuple[int, ...], str]

HEAD = """# gRPC

The service `oaisys.v1.SimulatorService`, written from
[simulator.proto](https://github.com/oaisys/interactive-oaisys/blob/main/oaisys_grpc/proto/oaisys/v1/simulator.proto).
[Clients](../clients.md) shows how it is used.
"""


def contract_page() -> str:
    """Return the page in Markdown."""
    file = _file()
    comments = {
        tuple(each.path): (each.leading_comments or each.trailing_comments).strip()
        for each in file.source_code_info.location
    }
    lines = [HEAD, comments.get((SYNTAX,), ""), ""]
    for index, service in enumerate(file.service):
        lines += [f"## {service.name}\n", *_methods(service, (SERVICE, index), comments)]
    lines.append("## Messages\n")
    for index, message in enumerate(file.message_type):
        lines += _message(message, message.name, (MESSAGE, index), comments)
    lines += ["## Enumerations\n"] if file.enum_type else []
    for index, enum in enumerate(file.enum_type):
        lines += _enum(enum, enum.name, (ENUM, index), comments)
    return "\n".join(lines)


def _file() -> Any:
    """Return the parsed contract, with its comments."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "set")
        command = python_command("grpc_tools.protoc", f"--proto_path={FOLDER}")
        command += ["--include_source_info", f"--descriptor_set_out={out}", FILE]
        subprocess.run(command, check=True, timeout=120)
        return FileDescriptorSet.FromString(out.read_bytes()).file[0]


def _methods(service: Any, path: Sequence[int], comments: Comments) -> Iterator[str]:
    for index, method in enumerate(service.method):
        request, answer = (_linked(name) for name in (method.input_type, method.output_type))
        stream = "a stream of " if method.server_streaming else ""
        yield f"### {method.name}\n"
        yield f"{request} → {stream}{answer}\n"
        yield comments.get((*path, 2, index), "") + "\n"


def _message(message: Any, name: str, path: Sequence[int], comments: Comments) -> Iterator[str]:
    yield f"### {name} {{ #{_anchor(name)} }}\n"
    yield comments.get(tuple(path), "") + "\n"
    if message.field:
        yield "| field | type | meaning |\n|---|---|---|"
        for index, field in enumerate(message.field):
            meaning = _cell(comments.get((*path, 2, index), ""))
            yield f"| `{field.name}` = {field.number} | {_type(field)} | {meaning} |"
        yield ""
    for index, part in enumerate(message.nested_type):
        if not part.options.map_entry:
            yield from _message(part, f"{name}.{part.name}", (*path, 3, index), comments)
    for index, part in enumerate(message.enum_type):
        yield from _enum(part, f"{name}.{part.name}", (*path, 4, index), comments)


def _enum(enum: Any, name: str, path: Sequence[int], comments: Comments) -> Iterator[str]:
    yield f"### {name} {{ #{_anchor(name)} }}\n"
    yield comments.get(tuple(path), "") + "\n"
    yield "| value | meaning |\n|---|---|"
    for index, value in enumerate(enum.value):
        meaning = _cell(comments.get((*path, 2, index), ""))
        yield f"| `{value.name}` = {value.number} | {meaning} |"
    yield ""


def _type(field: Any) -> str:
    kind = FieldDescriptorProto.Type.Name(field.type).removeprefix("TYPE_").lower()
    shown = _linked(field.type_name) if field.type_name else kind
    repeated = field.label == FieldDescriptorProto.LABEL_REPEATED
    return f"repeated {shown}" if repeated else shown


def _linked(name: str) -> str:
    """Return a message's name; those of this contract link to their section."""
    short = name.removeprefix(".oaisys.v1.")
    if short == name or short.endswith("Entry"):
        return f"`{short.removeprefix('.')}`"
    return f"[{short}](#{_anchor(short)})"


def _anchor(name: str) -> str:
    return "message-" + name.lower().replace(".", "-")


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")
