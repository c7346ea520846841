"""Who may connect, what a request may name, and how much it may ask for."""

from __future__ import annotations

import contextlib
import os
import socket
import stat
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import grpc
import numpy as np
import pytest
from blender_process import skip_without_blender
from certificates import Authority
from commands import oaisys_here
from grpc_health.v1 import health_pb2, health_pb2_grpc
from served_simulator import FLAT_WORLD, Server
from waiting import PATIENCE_S, SHUTDOWN_S, START_PATIENCE_S, within

from oaisys_core.config import config_from_mapping
from oaisys_core.config.section import Section
from oaisys_core.errors import ConfigError, InvalidInputError, OaisysError
from oaisys_core.geometry import pose_looking_down
from oaisys_core.types import ModuleMetadata
from oaisys_grpc.addresses import check_address
from oaisys_grpc.client.simulator_client import ClientTls, SimulatorClient
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2_grpc
from oaisys_grpc.tls import ServerTls

StartServer = Callable[..., Server]
NADIR = pose_looking_down(1, 2, 7)
MUCH_BYTES = 200 * 1024 * 1024
"""More than a refusal may take, less than what is refused would."""


def serve_in_vain(tmp_path: Path, *options: str) -> str:
    """Start a server that must refuse; return what it says."""
    command = [sys.executable, "-m", "oaisys_grpc", "serve", "--backend", "analytic", *options]
    env = {**os.environ, "XDG_STATE_HOME": str(tmp_path / "state")}
    done = subprocess.run(
        command,
        check=False,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        env=env,
        cwd=tmp_path,
    )
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    return done.stderr


def test_a_port_for_others_is_refused(tmp_path: Path) -> None:
    said = serve_in_vain(tmp_path, "--address", "0.0.0.0:0")
    assert "--address" in said
    assert "--insecure" in said
    assert "--tls-cert" in said


@pytest.mark.parametrize(
    "address",
    ["0.0.0.0:0", "[::]:0", "192.168.0.5:0", "0:0", ":0", "ipv4:0.0.0.0:0", "[::ffff:0.0.0.0]:0"],
)
def test_addresses_that_others_reach_need_tls_or_consent(address: str) -> None:
    with pytest.raises(InvalidInputError, match="--insecure"):
        check_address(address, insecure=False, encrypted=False)
    check_address(address, insecure=True, encrypted=False)
    check_address(address, insecure=False, encrypted=True)


@pytest.mark.parametrize("port", ["65536", "9" * 5000, "-1", "\u0661", ""])
def test_a_port_that_is_none_is_refused(port: str) -> None:
    with pytest.raises(InvalidInputError, match=r"--address.*HOST:PORT, with a port up to 65535"):
        check_address(f"127.0.0.1:{port}", insecure=False, encrypted=False)


def test_a_name_is_judged_by_what_it_stands_for() -> None:
    """This machine's name may stand for an address that others reach."""
    name = socket.gethostname()
    try:
        found = {info[4][0] for info in socket.getaddrinfo(name, None)}
    except OSError:
        found = {"nothing"}
    here = all(str(number).startswith("127.") or number == "::1" for number in found)
    for address in ("no.such.host.invalid:0", *([] if here else [f"{name}:0"])):
        with pytest.raises(InvalidInputError, match="--insecure"):
            check_address(address, insecure=False, encrypted=False)


def test_tls_encrypts_and_proves_the_server(start_server: StartServer, tmp_path: Path) -> None:
    authority, stranger = Authority(tmp_path), Authority(tmp_path, "stranger")
    cert, key = authority.pair("server")
    tls = ["--tls-cert", str(cert), "--tls-key", str(key)]
    server = start_server(FLAT_WORLD, *tls, "--address", "0.0.0.0:0")
    address = f"127.0.0.1:{server.address.rpartition(':')[2]}"
    with SimulatorClient(address, tls=ClientTls(ca=authority.ca)) as client:
        client.wait_ready(PATIENCE_S)
        assert client.step_batch() == 1
        depth_m = client.render_sample(NADIR).frame("camera", "depth").data
        np.testing.assert_allclose(depth_m, 7.0, rtol=1e-5)
    for wrong in (None, ClientTls(ca=stranger.ca)):
        with (
            SimulatorClient(address, timeout_s=5, tls=wrong) as client,
            pytest.raises(OaisysError),
        ):
            client.info()
    with SimulatorClient(address, tls=ClientTls(ca=authority.ca)) as client:
        assert client.is_ready(PATIENCE_S)


@pytest.mark.long
def test_mutual_tls_lets_only_known_clients_in(start_server: StartServer, tmp_path: Path) -> None:
    authority, stranger = Authority(tmp_path), Authority(tmp_path, "stranger")
    cert, key = authority.pair("server")
    tls = ["--tls-cert", str(cert), "--tls-key", str(key), "--tls-client-ca", str(authority.ca)]
    address = start_server(FLAT_WORLD, *tls).address
    own_cert, own_key = authority.pair("client")
    known = ClientTls(authority.ca, own_cert, own_key)
    for refused in (ClientTls(authority.ca), ClientTls(authority.ca, *stranger.pair("other"))):
        with (
            SimulatorClient(address, timeout_s=5, tls=refused) as client,
            pytest.raises(OaisysError),
        ):
            client.info()
    with SimulatorClient(address, tls=known) as client:
        client.wait_ready(PATIENCE_S)
        assert client.info().backend == "analytic"
        client.step_batch()
    ca, pair = ("--tls-ca", authority.ca), ("--tls-cert", own_cert, "--tls-key", own_key)
    server, out = ("--address", address), tmp_path / "heights.npz"
    for code, *options in (
        (0, *server, *ca, *pair),
        (1, *server, *ca),  # the server does not know this client
        (2, *server, *ca, "--tls-cert", own_cert),  # without its key
        (2, *ca),  # no server
    ):
        done = oaisys_here("heights", "--out", out, *options)
        assert done.returncode == code, done.stderr
        assert "Traceback" not in done.stderr
        assert out.exists() == (code == 0)
        out.unlink(missing_ok=True)


def test_keys_are_checked_before_anything_is_opened(tmp_path: Path) -> None:
    authority = Authority(tmp_path)
    cert, key = authority.pair("one")
    _, other_key = authority.pair("two")
    (tmp_path / "text").write_text("no certificate: hunter2")
    missing, pipe = tmp_path / "missing", tmp_path / "pipe"
    os.mkfifo(pipe)
    said = serve_in_vain(tmp_path, "--tls-cert", str(cert), "--tls-key", str(tmp_path / "text"))
    assert "--tls-key" in said
    assert "hunter2" not in said
    for given in ((cert, None, None), (None, key, None), (None, None, authority.ca)):
        with pytest.raises(InvalidInputError, match=r"--tls-(key|cert)"):
            ServerTls.of(*given)
    for tls, field in (
        (ServerTls(cert, other_key), "--tls-key"),
        (ServerTls(cert, missing), "--tls-key"),
        (ServerTls(missing, key), "--tls-cert"),
        (ServerTls(tmp_path / "text", key), "--tls-cert"),
        (ServerTls(key, key), "--tls-cert"),
        (ServerTls(cert, pipe), "--tls-key"),
        (ServerTls(cert, Path("/dev/zero")), "--tls-key"),
        (ServerTls(cert, key, pipe), "--tls-client-ca"),
        (ServerTls(cert, key, tmp_path / "text"), "--tls-client-ca"),
    ):
        with pytest.raises(InvalidInputError) as refused:
            tls.credentials()
        assert refused.value.field == field
        assert "hunter2" not in str(refused.value)
    with pytest.raises(InvalidInputError, match="tls_key"):
        SimulatorClient("127.0.0.1:1", tls=ClientTls(authority.ca, cert, other_key))
    with pytest.raises(InvalidInputError, match="tls_ca"):
        SimulatorClient("127.0.0.1:1", tls=ClientTls(missing))


@pytest.mark.long
def test_a_socket_is_its_owners_and_goes_with_its_server(
    start_server: StartServer, tmp_path: Path
) -> None:
    path = tmp_path / "simulator.sock"
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(path))  # as a server that was killed leaves it
    server = start_server(FLAT_WORLD, "--address", f"unix:{path}")
    assert server.address == f"unix:{path}"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    with server.client() as client:
        assert client.step_batch() == 1
        before = path.stat().st_ino
        second = start_server(FLAT_WORLD, "--address", f"unix:{path}")
        assert second.process.wait(PATIENCE_S) == 1
        assert "listens there already" in second.stderr.read_text()
        assert path.stat().st_ino == before
        assert client.render_sample(NADIR).sample_id == 1
        worker = server.worker()
        with within(SHUTDOWN_S):
            client.end_simulation()
            assert server.process.wait(PATIENCE_S) == 0
    assert not worker.is_running()
    assert not path.exists()


def test_a_file_is_not_taken_for_a_socket(start_server: StartServer, tmp_path: Path) -> None:
    path = tmp_path / "notes"
    path.write_text("mine")
    server = start_server(FLAT_WORLD, "--address", f"unix:{path}")
    assert server.process.wait(PATIENCE_S) == 1
    assert path.read_text() == "mine"


# What a request may name ---------------------------------------------------------------------


def naming(path: str, folder: str) -> dict[str, ModuleMetadata]:
    """Metadata that name a file or a folder, by the field that does."""
    standing = {"position_m": [0, 0, 0], "label": "thing", "semantic_id": 77}
    layer = {"label": "soil", "semantic_id": 3}
    labels_from = {"image": path, "mapping": {"0": layer}}
    return {
        "metadata.stage.dem.file": ModuleMetadata(custom={"stage": {"dem": {"file": path}}}),
        "metadata.stage.mesh.file": ModuleMetadata(custom={"stage": {"mesh": {"file": path}}}),
        "metadata.stage.reuse.file": ModuleMetadata(custom={"stage": {"reuse": {"file": path}}}),
        "metadata.materials.layers.0.folder": ModuleMetadata(
            custom={"materials": {"layers": [{**layer, "folder": folder}]}}
        ),
        "metadata.materials.layers.0.labels_from.image": ModuleMetadata(
            custom={"materials": {"layers": [{**layer, "labels_from": labels_from}]}}
        ),
        "metadata.environment.hdri.folder": ModuleMetadata(
            environment={"hdri": {"folder": folder}}
        ),
        "metadata.environment.hdri.images.0.file": ModuleMetadata(
            environment={"hdri": {"images": [{"file": path}]}}
        ),
        "metadata.environment.hdri.images.0.labels_from.0.image": ModuleMetadata(
            environment={"hdri": {"images": [{"file": "poses.csv", "labels_from": [labels_from]}]}}
        ),
        "metadata.asset.add.it.file": ModuleMetadata(
            asset={"add": {"it": {**standing, "file": path}}}
        ),
        "metadata.sensor.motion.path": ModuleMetadata(
            sensor={"motion": {"kind": "csv", "path": path}}
        ),
    }


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An asset root with a CSV file, a secret outside, and links from the one to the other."""
    top = tmp_path_factory.mktemp("places")
    for name in ("assets", "private"):
        (top / name).mkdir()
        (top / name / "poses.csv").write_text("x_m,y_m,z_m,qx,qy,qz,qw\n1,2,7,0,0.7071,0,0.7071\n")
    (top / "private/secret").write_text("hunter2")
    (top / "assets/link").symlink_to(top / "private")
    (top / "assets/link.csv").symlink_to(top / "private/poses.csv")
    (top / "assets/circle").symlink_to(top / "assets/circle")
    (top / "assets/folder").mkdir()
    (top / "assets/folder/image.hdr").symlink_to(top / "private/secret")
    return top


@pytest.fixture(scope="module")
def confined_server(tmp_path_factory: pytest.TempPathFactory, places: Path) -> Iterator[Server]:
    """A server for all, with asset roots; its folder has modules that must not be imported."""
    folder = tmp_path_factory.mktemp("security")
    for name in ("numpy", "random", "scipy", "yaml", "cv2", "open3d"):
        trap = f"open({str(folder / 'sprung')!r}, 'w')\nraise SystemExit"
        (folder / f"{name}.py").write_text(trap)
    options = ("--insecure", "--address", "0.0.0.0:0", "--asset-root", str(places / "assets"))
    with contextlib.chdir(folder):  # not longer: other programs of this module would start in it
        server = Server(folder / "server", FLAT_WORLD, *options)
    with server:
        yield server


@pytest.fixture(scope="module")
def confined(confined_server: Server) -> Iterator[SimulatorClient]:
    """A client as others have it; a first batch stands."""
    port = confined_server.address.rpartition(":")[2]
    with SimulatorClient(f"127.0.0.1:{port}", timeout_s=PATIENCE_S) as client:
        client.step_batch()
        yield client


def test_insecure_serves_others(confined: SimulatorClient) -> None:
    assert confined.is_ready(PATIENCE_S)


FIELDS = tuple(naming("", ""))


@pytest.mark.parametrize("field", FIELDS)
def test_no_field_reads_outside_the_asset_roots(
    confined: SimulatorClient, places: Path, field: str
) -> None:
    outside = [str(places / "private/secret"), "../private/secret", "link/secret", "/etc/passwd"]
    folders = [str(places / "private"), "../private", "link", "/etc"]
    said = set()
    for path, folder in zip(outside, folders, strict=True):
        metadata = naming(path, folder)[field]
        with pytest.raises(InvalidInputError) as refused:
            confined.step_batch(metadata=metadata)
        assert refused.value.field == field
        assert "inside the asset roots" in refused.value.expected
        said.add(refused.value.expected)
    # What is not there is refused in the same words: nobody learns what is.
    with pytest.raises(InvalidInputError) as refused:
        confined.step_batch(metadata=naming("/no/such/file", "/no/such/folder")[field])
    assert said == {refused.value.expected}
    assert "hunter2" not in str(refused.value)


@pytest.mark.parametrize(
    "path", ["link.csv", "circle", "a\0b", "x" * 5000, "~root/poses.csv", "~nobody9/x", ".", ""]
)
def test_odd_paths_are_refused(confined: SimulatorClient, path: str) -> None:
    metadata = ModuleMetadata(sensor={"motion": {"kind": "csv", "path": path}})
    with pytest.raises(InvalidInputError) as refused:
        confined.step_batch(metadata=metadata)
    assert refused.value.field == "metadata.sensor.motion.path"


def test_a_folder_with_links_out_of_the_roots_is_refused(confined: SimulatorClient) -> None:
    with pytest.raises(InvalidInputError, match="links stay inside"):
        confined.render_sample(metadata=ModuleMetadata(environment={"hdri": {"folder": "folder"}}))


def test_every_path_of_the_configuration_is_one_that_is_confined() -> None:
    """Only folders to write to may be a plain `Path`, which would be read wherever it points."""
    unchecked = set()
    for section in _sections(Section):
        for name, described in section.model_fields.items():
            text = repr(described.annotation) + repr(described.metadata)
            if "Path" in text and "_file" not in text and "_folder" not in text:
                unchecked.add(f"{section.__name__}.{name}")
    assert unchecked == {"OutputConfig.folder", "StageConfig.store"}


def _sections(section: type[Section]) -> set[type[Section]]:
    return {section}.union(*map(_sections, section.__subclasses__()))


def test_files_in_the_roots_are_read(confined: SimulatorClient, places: Path) -> None:
    for path in ("poses.csv", str(places / "assets/poses.csv"), "folder/../poses.csv"):
        metadata = ModuleMetadata(sensor={"motion": {"kind": "csv", "path": path}})
        confined.step_batch(metadata=metadata)
        assert confined.render_sample().rig_pose.position_m == pytest.approx((1, 2, 7))
    confined.step_batch()


@pytest.mark.long
def test_the_configuration_may_name_any_file(start_server: StartServer, places: Path) -> None:
    """What the operator named stays in force when a request changes something beside it."""
    motion = {"kind": "csv", "path": str(places / "private/poses.csv")}
    elevation = {"file": str(places / "heights.png"), "spacing_m": 1.0}
    import cv2

    cv2.imwrite(elevation["file"], np.zeros((40, 40), np.uint16))
    stage = {**FLAT_WORLD["stage"], "dem": elevation}
    world = {**FLAT_WORLD, "stage": stage}
    world["sensors"] = {**FLAT_WORLD["sensors"], "motion": motion}
    with start_server(world).client() as client:
        client.step_batch(metadata=ModuleMetadata(custom={"stage": {"dem": {"scale": 2.0}}}))
        assert client.render_sample().rig_pose.position_m == pytest.approx((1, 2, 7))
        other = ModuleMetadata(custom={"stage": {"dem": {"file": str(places / "private/secret")}}})
        with pytest.raises(InvalidInputError, match="asset roots"):
            client.step_batch(metadata=other)


def test_the_default_root_is_the_configurations_folder(
    flat_server: Server, flat_client: SimulatorClient
) -> None:
    near = flat_server.stdout.with_name("near.csv")
    near.write_text("x_m,y_m,z_m,qx,qy,qz,qw\n0,0,9,0,0,0,1\n")
    metadata = ModuleMetadata(sensor={"motion": {"kind": "csv", "path": "near.csv"}})
    flat_client.step_batch(metadata=metadata)
    assert flat_client.render_sample().rig_pose.position_m == (0, 0, 9)
    flat_client.step_batch()


def test_a_worker_imports_nothing_from_the_current_folder(
    confined_server: Server, confined: SimulatorClient
) -> None:
    confined.render_sample(NADIR, modalities=["depth"])
    started_in = confined_server.stdout.parent.parent
    assert (started_in / "numpy.py").exists()
    assert not (started_in / "sprung").exists()


def test_hostile_files_in_the_asset_roots_are_refused_and_the_worker_lives(
    confined: SimulatorClient, places: Path
) -> None:
    """What a request names lies where it may, but is a bomb, or leads elsewhere."""
    assets = places / "assets"
    header = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + struct.pack(
        ">IIBBBBB", 60_000, 60_000, 16, 0, 0, 0, 0
    )
    (assets / "bomb.png").write_bytes(header + bytes(100))
    vrt = "<VRTDataset rasterXSize='4' rasterYSize='4'/>"
    (assets / "vrt.tif").write_text(vrt)
    (assets / "mesh.obj").write_text(
        "mtllib ../private/secret\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    )
    hostile = {
        "60000 x 60000": {"dem": {"file": "bomb.png", "spacing_m": 1.0}},
        "can be read": {"dem": {"file": "vrt.tif", "spacing_m": 1.0}},
        "own folder or in the asset roots": {"mesh": {"file": "mesh.obj"}},
    }
    for expected, stage in hostile.items():
        with pytest.raises(InvalidInputError, match=expected):
            confined.step_batch(metadata=ModuleMetadata(custom={"stage": stage}))
    confined.step_batch()
    assert confined.info().worker_restarts == 0


MAKE_BLEND = """
import os, sys, bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.mesh.primitive_cube_add()
bpy.context.object.driver_add("location", 2).driver.expression = "len(str(frame)) * 0.0"
text = bpy.data.texts.new("attack.py")
text.write(f"open({sys.argv[2]!r}, 'w')")
text.use_module = True
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1])
os._exit(0)  # with a driver, Blender's own end may never come
"""


@pytest.mark.long
def test_scripts_in_a_blend_file_never_run(start_server: StartServer, tmp_path: Path) -> None:
    skip_without_blender()
    roots, attacked = tmp_path / "roots", tmp_path / "attacked"
    roots.mkdir()
    file = roots / "cube.blend"
    command = [sys.executable, "-c", MAKE_BLEND, str(file), str(attacked)]
    subprocess.run(command, check=True, capture_output=True, timeout=START_PATIENCE_S)
    assert not attacked.exists()
    camera = {"width_px": 16, "height_px": 12, "fx_px": 14.0, "fy_px": 14.0}
    world = {**FLAT_WORLD, "backend": "blender", "sensors": {"cameras": [camera]}}
    thing = {"file": "cube.blend", "position_m": [1, 2, 0], "label": "cube", "semantic_id": 30}
    with start_server(world, "--asset-root", str(roots)).client() as client:
        client.step_batch(metadata=ModuleMetadata(asset={"add": {"cube": thing}}))
        depth_m = client.render_sample(NADIR, modalities=["depth"]).frames[0].data
    assert depth_m.min() < 6.5  # the cube is there
    assert not attacked.exists()


# How much a request may ask for ----------------------------------------------------------------

ABSURD = {
    "metadata.stage.resolution_px": ModuleMetadata(custom={"stage": {"resolution_px": 100_000}}),
    "metadata.materials.texture_size_px": ModuleMetadata(
        custom={"materials": {"texture_size_px": 100_000}}
    ),
    "metadata.materials.mask.size_px": ModuleMetadata(
        custom={"materials": {"mask": {"size_px": 100_000}}}
    ),
    "metadata.asset.count_factor": ModuleMetadata(asset={"count_factor": 1e12}),
    "metadata.render.samples": ModuleMetadata(render={"samples": 10**9}),
    "metadata.render.effects.bloom.radius_px": ModuleMetadata(
        render={"effects": {"bloom": {"radius_px": 1e9}}}
    ),
    "metadata.sensor.cameras.camera.width_px": ModuleMetadata(
        sensor={"cameras": {"camera": {"width_px": 100_000}}}
    ),
    "metadata.sensor.motion.columns": ModuleMetadata(
        sensor={"motion": {"kind": "grid", "columns": 10**12}}
    ),
}


@pytest.mark.parametrize("field", ABSURD)
def test_what_is_too_much_is_refused_before_it_is_allocated(
    flat_server: Server, flat_client: SimulatorClient, field: str
) -> None:
    worker = flat_server.worker()
    before_bytes = worker.memory_info().rss
    kept = flat_client.info()
    with pytest.raises(InvalidInputError) as refused:
        flat_client.step_batch(metadata=ABSURD[field])
    assert refused.value.field == field
    assert worker.memory_info().rss - before_bytes < MUCH_BYTES
    info = flat_client.info()
    assert (info.batch_id, info.sample_id) == (kept.batch_id, kept.sample_id)


@pytest.mark.parametrize(
    ("path", "section"),
    [
        ("sensors.cameras.0.width_px", {"sensors": {"cameras": [{"width_px": 100_000}]}}),
        (
            "sensors.cameras.0:",
            {"sensors": {"cameras": [{"width_px": 16_000, "height_px": 16_000}]}},
        ),
        ("render.samples", {"render": {"samples": 10**9}}),
        ("assets.rocks.0.count", {"assets": {"rocks": [{"count": [0, 10**12]}]}}),
        (
            "assets.groups.0.count",
            {"assets": {"groups": [{"name": "a", "shape": "bush", "count": [0, 10**12]}]}},
        ),
        ("stage.resolution_px", {"stage": {"resolution_px": 100_000}}),
    ],
)
def test_absurd_configurations_are_refused(path: str, section: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=path):
        config_from_mapping({**FLAT_WORLD, **section})


def test_lists_without_end_are_refused(flat_server: Server, flat_client: SimulatorClient) -> None:
    with pytest.raises(InvalidInputError, match="modalities"):
        flat_client.render_sample(modalities=["depth"] * 100_000)
    with grpc.insecure_channel(flat_server.address) as channel:
        stub = simulator_pb2_grpc.SimulatorServiceStub(channel)
        points = pb.QueryHeightRequest(points_m=[0.0] * 300_003)
        with pytest.raises(grpc.RpcError) as refused:
            stub.QueryHeight(points, timeout=PATIENCE_S)
    assert refused.value.code() == grpc.StatusCode.INVALID_ARGUMENT
    assert "points_m" in str(refused.value.details())


def test_long_names_and_values_are_refused(flat_client: SimulatorClient) -> None:
    metadata = ModuleMetadata(environment={"x" * 1_000_000: "y" * 1_000_000})
    with pytest.raises(InvalidInputError) as refused:
        flat_client.step_batch(metadata=metadata)
    assert refused.value.field.startswith("metadata.environment.x")
    assert len(str(refused.value)) < 10_000


@pytest.mark.parametrize("depth", [30, 90, 5000])
def test_metadata_in_metadata_end_with_a_status(flat_server: Server, depth: int) -> None:
    value = b""
    for _ in range(depth):  # Value.struct_value = 5, Struct.fields = 1, with key = 1 and value = 2
        entry = b"\x0a\x01x" + _field(2, value)
        value = _field(5, _field(1, entry))
    struct = _field(1, b"\x0a\x01x" + _field(2, value))
    request = _field(2, _field(2, struct))  # StepSampleRequest.metadata, .environment
    with grpc.insecure_channel(flat_server.address) as channel:
        raw: Any = channel.unary_stream("/oaisys.v1.SimulatorService/RenderSample")
        with pytest.raises(grpc.RpcError) as refused:
            list(raw(request, timeout=PATIENCE_S))
    assert refused.value.code() in (grpc.StatusCode.INVALID_ARGUMENT, grpc.StatusCode.INTERNAL)
    assert _serves(flat_server.address)


def _field(number: int, content: bytes) -> bytes:
    """A field of a message that holds bytes, as protobuf writes it."""
    size, length = len(content), b""
    while size > 127:
        length += bytes([size & 127 | 128])
        size >>= 7
    return bytes([number << 3 | 2]) + length + bytes([size]) + content


def test_a_message_that_is_too_large_is_not_read(flat_server: Server) -> None:
    with grpc.insecure_channel(
        flat_server.address, options=[("grpc.max_send_message_length", -1)]
    ) as channel:
        raw: Any = channel.unary_unary("/oaisys.v1.SimulatorService/StepBatch")
        with pytest.raises(grpc.RpcError) as refused:
            raw(bytes(32 * 1024 * 1024), timeout=PATIENCE_S)
    assert refused.value.code() == grpc.StatusCode.RESOURCE_EXHAUSTED
    assert _serves(flat_server.address)


def test_random_bytes_on_the_port_do_no_harm(flat_server: Server) -> None:
    host, port = flat_server.address.split(":")
    rng = np.random.default_rng(5)
    preface = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
    for begin in (b"", preface, b"\x16\x03\x01\x02\x00"):
        for _ in range(10):
            with socket.create_connection((host, int(port)), timeout=PATIENCE_S) as connection:
                connection.settimeout(0.05)
                try:
                    connection.sendall(begin + rng.bytes(4096))
                    while connection.recv(4096):
                        pass
                except OSError:
                    pass  # it hung up, or waits for more
    assert _serves(flat_server.address)


def _serves(address: str) -> bool:
    with grpc.insecure_channel(address) as channel:
        stub = health_pb2_grpc.HealthStub(channel)
        answer = stub.Check(health_pb2.HealthCheckRequest(), timeout=PATIENCE_S)
    return bool(answer.status == health_pb2.HealthCheckResponse.SERVING)
