"""Metadata as typed messages: the same as open-ended ones, key by key, and never both."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import grpc
import pytest
from google.rpc import error_details_pb2
from grpc_status import rpc_status
from hypothesis import given, settings
from hypothesis import strategies as st
from served_simulator import Server

from oaisys_core.config.sections.environment import (
    CloudsConfig,
    EnvironmentConfig,
    HazeConfig,
    SkyConfig,
)
from oaisys_core.config.sections.lamps import LampConfig
from oaisys_core.config.sections.render import (
    AutoExposureConfig,
    BloomConfig,
    EffectsConfig,
    RenderConfig,
    SensorNoiseConfig,
)
from oaisys_core.config.sections.sensing.cameras import DistortionConfig, LensConfig, OpticsConfig
from oaisys_core.config.sections.sun import SunFromTimeConfig as SunFromTime
from oaisys_core.errors import InvalidInputError
from oaisys_core.types import ModuleMetadata
from oaisys_core.world.modules.assets.metadata import AssetMetadata, GroupEdit, ObjectEdit
from oaisys_grpc.contract.metadata import metadata_from_proto, metadata_to_proto
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2_grpc

MODELS: dict[Any, Any] = {
    pb.EnvironmentMetadata: EnvironmentConfig,
    pb.SunFromTimeMetadata: SunFromTime,
    pb.SkyMetadata: SkyConfig,
    pb.HazeMetadata: HazeConfig,
    pb.CloudsMetadata: CloudsConfig,
    pb.LampMetadata: LampConfig,
    pb.AssetMetadata: AssetMetadata,
    pb.GroupMetadata: GroupEdit,
    pb.ObjectMetadata: ObjectEdit,
    pb.RenderMetadata: RenderConfig,
    pb.EffectsMetadata: EffectsConfig,
    pb.AutoExposureMetadata: AutoExposureConfig,
    pb.BloomMetadata: BloomConfig,
    pb.SensorNoiseMetadata: SensorNoiseConfig,
    pb.CameraMetadata: OpticsConfig,
    pb.LensMetadata: LensConfig,
    pb.DistortionMetadata: DistortionConfig,
}
OPEN_ENDED = {"sky_label", "sky_levels", "ground_beyond_label", "effects"}
"""Lists of an environment that have no typed field; an effect's options are a package's own."""

numbers = st.floats(allow_nan=False, allow_infinity=False)
texts = st.text(max_size=8)
names = st.text("abcXYZ_09", min_size=1, max_size=6)
json_values: st.SearchStrategy[Any] = st.recursive(
    st.none() | st.booleans() | numbers | st.integers(-(2**53), 2**53) | texts,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(texts, inner, max_size=4),
    max_leaves=8,
)


def typed_values(field: Any) -> st.SearchStrategy[Any]:
    """JSON values of a module's key that its typed field can hold."""
    kind = field.message_type
    if kind is not None and kind.GetOptions().map_entry:
        inner = typed_values(kind.fields_by_name["value"])
        return st.dictionaries(names, inner | json_values, max_size=3)
    if kind is not None and kind.name == "Range":
        return numbers | st.lists(numbers, min_size=2, max_size=2)
    if kind is not None and kind.name in ("Color", "Vector3", "Quaternion"):
        return st.lists(numbers, min_size=len(kind.fields), max_size=len(kind.fields))
    if kind is not None and kind.name == "Struct":
        return st.dictionaries(texts, json_values, max_size=3)
    if kind is not None:
        return mappings(kind)
    scalars = {
        field.CPPTYPE_DOUBLE: numbers,
        field.CPPTYPE_INT32: st.integers(-(2**33), 2**33),
        field.CPPTYPE_BOOL: st.booleans(),
        field.CPPTYPE_STRING: texts,
    }
    scalar: st.SearchStrategy[Any] = scalars[field.cpp_type]
    return st.lists(scalar, max_size=3) if field.is_repeated else scalar


def mappings(kind: Any) -> st.SearchStrategy[dict[str, Any]]:
    """Mappings of a module's keys: most values fit, some do not, some keys are unknown."""
    known = {field.name: typed_values(field) | json_values for field in kind.fields}
    return st.builds(
        lambda fits, other: {**other, **fits},
        st.fixed_dictionaries({}, optional=known),
        st.dictionaries(names, json_values, max_size=2),
    )


metadata = st.builds(
    ModuleMetadata,
    sensor=st.none()
    | st.fixed_dictionaries(
        {},
        optional={"cameras": typed_values(pb.SensorMetadata.DESCRIPTOR.fields_by_name["cameras"])},
    ),
    environment=st.none() | mappings(pb.EnvironmentMetadata.DESCRIPTOR),
    asset=st.none() | mappings(pb.AssetMetadata.DESCRIPTOR),
    render=st.none() | mappings(pb.RenderMetadata.DESCRIPTOR),
    custom=st.dictionaries(names, st.dictionaries(names, json_values, max_size=2), max_size=2),
)


@given(metadata)
@settings(max_examples=40, deadline=None)
def test_all_metadata_come_back_typed_or_not(sent: ModuleMetadata) -> None:
    message = pb.ModuleMetadata.FromString(metadata_to_proto(sent).SerializeToString())
    came = metadata_from_proto(message)
    for part in ("sensor", "environment", "asset", "render", "custom"):
        assert getattr(came, part) == getattr(sent, part)


@given(metadata)
@settings(max_examples=25, deadline=None)
def test_typed_messages_say_what_structs_say(sent: ModuleMetadata) -> None:
    """A client that knows no typed message sends the JSON as it is."""
    plain = pb.ModuleMetadata()
    for part in ("environment", "asset", "render"):
        values = getattr(sent, part)
        if values is not None:
            getattr(plain, part).SetInParent()
            getattr(plain, part).update(json.loads(json.dumps(values)))
    typed = metadata_to_proto(sent)
    typed.ClearField("sensor")
    typed.ClearField("custom")
    came = [vars(metadata_from_proto(message)) for message in (plain, typed)]
    assert json.dumps(came[0], sort_keys=True) == json.dumps(came[1], sort_keys=True)


@pytest.mark.parametrize("message", MODELS, ids=lambda m: m.DESCRIPTOR.name)
def test_typed_fields_are_the_modules_keys(message: Any) -> None:
    fields = set(message.DESCRIPTOR.fields_by_name)
    keys = set(MODELS[message].model_fields)
    assert fields <= keys
    assert keys - fields <= (OPEN_ENDED if message is pb.EnvironmentMetadata else set())


def test_what_the_client_says_in_plain_cases_is_typed() -> None:
    message = metadata_to_proto(
        ModuleMetadata(
            sensor={"cameras": {"left": {"lens": {"f_number": 4}, "cx_px": 1.5}}},
            environment={
                "sun_elevation_deg": [10, 20],
                "air": 2,
                "haze": {"visibility_m": 100},
                "clouds": {"cover": [0.2, 0.4]},
                "lamps": {"left": {"enabled": False, "strength_w": 20, "position_m": [1, 2, 3]}},
            },
            asset={"groups": {"stones": {"hidden": True}}, "objects": {"3": {"scale": 2}}},
            render={"quality": "preview", "passes": ["depth"], "effects": {"vignetting": 0.5}},
        )
    )
    assert not any(message.HasField(part) for part in ("environment", "asset", "render"))
    assert not message.sensor.HasField("settings")
    assert message.sensor.cameras["left"].lens.f_number == 4
    assert message.typed_environment.sun_elevation_deg == pb.Range(least=10, most=20)
    assert message.typed_environment.air == pb.Range(least=2)
    assert message.typed_environment.haze.visibility_m.least == 100
    assert message.typed_environment.clouds.cover.most == 0.4
    left = message.typed_environment.lamps["left"]
    assert left.HasField("enabled")
    assert not left.enabled
    assert left.strength_w == pb.Range(least=20)
    assert left.position_m == pb.Vector3(x=1, y=2, z=3)
    assert message.typed_asset.groups["stones"].hidden
    assert message.typed_asset.objects["3"].scale == 2
    assert list(message.typed_render.passes) == ["depth"]
    assert message.typed_render.effects.vignetting == 0.5


def doubled() -> Iterator[tuple[str, pb.ModuleMetadata]]:
    """Messages that give a key twice, and the key's path."""
    message = pb.ModuleMetadata(typed_environment=pb.EnvironmentMetadata(air=pb.Range(least=1)))
    message.environment.update({"dust": 2, "air": 1})
    yield "metadata.environment.air", message
    message = pb.ModuleMetadata(typed_render=pb.RenderMetadata(samples=3))
    message.render.update({"samples": 3})
    yield "metadata.render.samples", message
    message = pb.ModuleMetadata(typed_asset=pb.AssetMetadata(groups={"a": pb.GroupMetadata()}))
    message.asset.update({"groups": {"b": {"scale": 2}}})
    yield "metadata.asset.groups", message
    message = pb.ModuleMetadata()
    message.sensor.cameras["camera"].fx_px = 100
    message.sensor.settings.update({"cameras": {"other": {"fx_px": 100}}})
    yield "metadata.sensor.cameras", message


DOUBLED = dict(doubled())


@pytest.mark.parametrize("path", DOUBLED)
def test_a_key_that_comes_both_ways_is_refused(path: str) -> None:
    with pytest.raises(InvalidInputError) as refused:
        metadata_from_proto(DOUBLED[path])
    assert refused.value.field == path
    assert "not in both" in refused.value.expected


def rendered(stub: Any, metadata: pb.ModuleMetadata) -> list[bytes]:
    """The chunks of a sample's colour."""
    request = pb.RenderSampleRequest(metadata=metadata, modalities=["rgb"])
    return [a.part.chunk.data for a in stub.RenderSample(request) if a.part.HasField("chunk")]


def violations(error: grpc.RpcError) -> list[str]:
    found = []
    for detail in rpc_status.from_call(error).details:
        bad = error_details_pb2.BadRequest()
        if detail.Unpack(bad):
            found += [violation.field for violation in bad.field_violations]
    return found


def test_a_server_takes_either_and_refuses_both(stepped_flat_server: Server) -> None:
    with grpc.insecure_channel(stepped_flat_server.address) as channel:
        stub = simulator_pb2_grpc.SimulatorServiceStub(channel)
        before = rendered(stub, pb.ModuleMetadata())
        typed = rendered(stub, pb.ModuleMetadata(typed_render=pb.RenderMetadata(exposure_ev=-1)))
        assert typed != before
        open_ended = pb.ModuleMetadata()
        open_ended.render.update({"exposure_ev": None})
        assert rendered(stub, open_ended) == before
        open_ended.render.update({"exposure_ev": -1})
        assert rendered(stub, open_ended) == typed
        for path, message in DOUBLED.items():
            with pytest.raises(grpc.RpcError) as refused:
                rendered(stub, message)
            assert refused.value.code() == grpc.StatusCode.INVALID_ARGUMENT
            assert violations(refused.value) == [path]
        wrong = pb.EnvironmentMetadata(sun_elevation_deg=pb.Range(least=91))
        with pytest.raises(grpc.RpcError) as refused:
            rendered(stub, pb.ModuleMetadata(typed_environment=wrong))
        assert violations(refused.value) == ["metadata.environment.sun_elevation_deg"]
        assert rendered(stub, pb.ModuleMetadata()) == typed


def test_lamps_are_switched_by_typed_messages(stepped_flat_server: Server) -> None:
    def lamps(**left: Any) -> pb.ModuleMetadata:
        environment = pb.EnvironmentMetadata(lamps={"left": pb.LampMetadata(**left)})
        return pb.ModuleMetadata(typed_environment=environment)

    place = {"frame": "base_link", "position_m": pb.Vector3(x=0, y=0, z=1)}
    with grpc.insecure_channel(stepped_flat_server.address) as channel:
        stub = simulator_pb2_grpc.SimulatorServiceStub(channel)
        dark = rendered(stub, pb.ModuleMetadata())
        lit = rendered(stub, lamps(kind="spot", strength_w=pb.Range(least=900), **place))
        assert lit != dark
        assert rendered(stub, lamps(enabled=False)) == dark
        with pytest.raises(grpc.RpcError) as refused:
            rendered(stub, lamps(cone_deg=300, enabled=True))
        assert violations(refused.value) == ["metadata.environment.lamps.left.cone_deg"]
        assert rendered(stub, pb.ModuleMetadata()) == dark
