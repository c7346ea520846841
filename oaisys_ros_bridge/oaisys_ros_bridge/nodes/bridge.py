"""Node ``oaisys_bridge``: pose requests in, samples of the simulator out."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory

from oaisys_core.errors import InvalidInputError, NotReadyError, OaisysError
from oaisys_core.types import SampleOutline, SimulatorInfo
from oaisys_grpc.client.simulator_client import client_tls
from oaisys_grpc.memory import keep_freed_memory
from oaisys_msgs.srv import SetMetadata, SetPose, StepBatch
from oaisys_ros_bridge.bridge.command_queue import CommandQueue
from oaisys_ros_bridge.bridge.diagnostics import (
    FIRST_BATCH_ERROR,
    FIRST_BATCH_RETRIED,
    SUBSCRIBERS,
    diagnostics_msg,
    resident_mb,
    simulator_values,
)
from oaisys_ros_bridge.bridge.readers import Readers
from oaisys_ros_bridge.bridge.rendering import Renderer, View
from oaisys_ros_bridge.bridge.requests import (
    metadata_of_module,
    metadata_of_modules,
    poses_of_trajectory,
)
from oaisys_ros_bridge.bridge.simulator_link import LinkState, SimulatorLink
from oaisys_ros_bridge.bridge.sweep import sweep_server
from oaisys_ros_bridge.bridge.turns import Turns
from oaisys_ros_bridge.nodes.managed_node import (
    ACTIVE,
    FINALIZED,
    INACTIVE,
    UNCONFIGURED,
    ManagedNode,
)
from oaisys_ros_bridge.nodes.node_process import OWN_CLOCK, run_node
from oaisys_ros_bridge.parameters.bridge import BRIDGE
from oaisys_ros_bridge.parameters.node_parameters import ParameterNode
from oaisys_ros_bridge.parameters.table import Changeable, ParameterRow
from oaisys_ros_bridge.publishing.publication import Publication
from oaisys_ros_bridge.publishing.world_topics import WorldTopics
from oaisys_ros_bridge.qos import LATCHED_QOS, NEWEST_QOS
from oaisys_ros_bridge.simulation_interfaces.simulation import Simulation
from oaisys_ros_bridge.simulation_interfaces.worlds import WorldRequest

if TYPE_CHECKING:
    from oaisys_ros_bridge.simulation_interfaces.services import SimulationServices

DIAGNOSTICS_PERIOD_S = 1.0
ACTIVATION_TIMEOUT_S = 5.0
"""How long a request waits for a bridge that has just found its simulator again."""
THREADS = 16
"""Enough for one of each kind of request to wait for its turn, and for all else to go on."""


class BridgeNode(ParameterNode, ManagedNode):
    """Renders where it is asked to, one request at a time, and publishes what comes back.

    A managed node: configured, it knows the simulator and offers its topics; active, it renders.
    By default it goes there by itself, and again whenever the simulator has come back.
    Its parameters are the rows of `oaisys_ros_bridge.parameters.bridge.BRIDGE`.

    Args:
        stop: Set once somebody has shut the node down: there is no way back from that.
    """

    def __init__(self, stop: threading.Event) -> None:
        super().__init__("oaisys_bridge")
        self.declare_table(BRIDGE)
        self._stop = stop
        self._turns = Turns()
        self._link: SimulatorLink | None = None
        self._readers = Readers(self, lambda: self.parameters)
        self._topics = WorldTopics(self, lambda: self.parameters, self._readers)
        self._ready_lock = threading.Lock()
        self._announced_ready: bool | None = None
        self._ready = self.create_publisher(Bool, "~/ready", LATCHED_QOS)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._renderer = Renderer(
            self._turns,
            ready_link=self._ready_link,
            begin=self._begin,
            map_frame=lambda: str(self.parameters["map_frame"]),
            readers=self._readers,
            on_sample=self._publish_diagnostics,
        )
        self._commands = CommandQueue(
            self._turns,
            lambda pose: self._renderer.render(View(pose)),
            lambda reason: self.get_logger().warning(f"command refused: {reason}"),
        )
        self._sweeps = sweep_server(self, self._renderer)
        self._simulation = Simulation(self._renderer, self._configured_link, self._topics)
        self._simulation_services = self._simulation_interfaces()
        self._create_interfaces()
        self._publish_ready()
        if self.parameters["autostart"]:
            self._link = self._new_link()
            self._link.start()
            self.set_aim(ACTIVE)

    def close(self) -> None:
        """Let go of the simulator."""
        self.stop_rendering("the bridge ends")
        self._commands.close()
        if self._link is not None:
            self._link.close()

    def configure(self) -> None:
        """Find the simulator and offer its topics."""
        if self._link is None:
            link = self._new_link()
            try:
                info = link.look()
            except OaisysError:
                link.close()
                raise
            self._link = link
            self._topics.offer(info)
            self._topics.tell_configuration(link.config_json)
            link.start()
        else:
            self._topics.offer(_known(self._link))

    def activate(self) -> None:
        """Make sure that a world stands, and say which."""
        link = self._configured_link()
        if not link.state.ready:
            with self._turns:
                link.check()
        if not link.state.ready:
            raise NotReadyError(link.state.reason)
        self._topics.announce(_known(link))

    def deactivate(self) -> None:
        """Stop what renders."""
        self.stop_rendering("the bridge was deactivated")

    def cleanup(self, *, for_good: bool) -> None:
        """Let go of the simulator and of its topics, or keep looking for it where it was lost."""
        self._renderer.forget_world()
        self._simulation.forget()
        if not for_good:
            return
        link, self._link = self._link, None
        if link is not None:
            link.close()
        self._topics.withdraw()

    def reachable(self) -> int:
        """Return what the simulator allows: to be active, a world must stand."""
        link = self._link
        if link is None or link.state.info is None:
            return UNCONFIGURED
        return ACTIVE if link.state.ready or self.state == ACTIVE else INACTIVE

    def on_settled(self) -> None:
        """Tell those who wait for the bridge; end where it was shut down."""
        self._publish_ready()
        self._publish_diagnostics()
        if self.state == FINALIZED:
            self._stop.set()

    def reason_against(self, row: ParameterRow) -> str:
        """Return why a parameter cannot be set now, or nothing."""
        if row.changeable is Changeable.UNCONFIGURED and self.state != UNCONFIGURED:
            return f"no change while the bridge is {self.state_name}: clean it up first"
        return super().reason_against(row)

    def on_parameters(self, changed: Mapping[str, Any]) -> None:
        """Take new values into use; most are read where they are needed."""
        link = self._link
        if link is None:
            return
        link.initial_batch = self.parameters["initial_batch"]
        unconfigured = {row.name for row in BRIDGE if row.changeable is Changeable.UNCONFIGURED}
        if unconfigured & changed.keys():
            link.close()
            self._link = self._new_link()
            self._link.start()

    def stop_rendering(self, reason: str) -> None:
        """End what is under way and what waits behind it."""
        self._commands.replace(())
        self._sweeps.stop(reason)
        if self._simulation_services is not None:
            self._simulation_services.stop(reason)
        self._renderer.stop(reason)

    def _new_link(self) -> SimulatorLink:
        values = self.parameters
        return SimulatorLink(
            values["address"],
            self._turns,
            initial_batch=values["initial_batch"],
            timeout_s=values["timeout_s"],
            on_change=self._follow,
            tls=client_tls(values["tls_ca"], values["tls_cert"], values["tls_key"]),
        )

    def _simulation_interfaces(self) -> SimulationServices | None:
        """Offer them where they are wanted and the machine has their types."""
        if not self.parameters["simulation_interfaces"]:
            return None
        try:
            from oaisys_ros_bridge.simulation_interfaces.services import SimulationServices
        except ImportError as error:
            self.get_logger().warning(f"simulation_interfaces are not offered: {error}")
            return None
        return SimulationServices(
            self,
            self._simulation,
            self._renderer,
            base_frame=lambda: str(self.parameters["base_frame"]),
            max_entities=lambda: int(self.parameters["max_entities"]),
        )

    def _create_interfaces(self) -> None:
        """Offer the services; each waits for the simulator in a group of its own."""
        services: tuple[tuple[Any, str, Callable[..., Any]], ...] = (
            (SetPose, "~/set_pose", self._on_set_pose),
            (StepBatch, "~/step_batch", self._on_step_batch),
            (SetMetadata, "~/set_metadata", self._on_set_metadata),
            (Trigger, "~/end_simulation", self._on_end_simulation),
        )
        for kind, name, callback in services:
            group = MutuallyExclusiveCallbackGroup()
            self.create_service(kind, name, callback, callback_group=group)
        commands: tuple[tuple[Any, str, Callable[[Any], None]], ...] = (
            (PoseStamped, "command/pose", self._on_command_pose),
            (MultiDOFJointTrajectory, "command/trajectory", self._on_command_trajectory),
        )
        group = MutuallyExclusiveCallbackGroup()
        for kind, name, callback in commands:
            self.create_subscription(kind, name, callback, NEWEST_QOS, callback_group=group)
        self.create_timer(
            DIAGNOSTICS_PERIOD_S,
            self._publish_diagnostics,
            callback_group=MutuallyExclusiveCallbackGroup(),
            clock=OWN_CLOCK,
        )

    def _on_set_pose(self, request: SetPose.Request, response: SetPose.Response) -> Any:
        try:
            view = View(request.pose, request.sensor, request.modalities)
            sample, stamp = self._renderer.render(view)
        except OaisysError as error:
            response.message = str(error)
            self.get_logger().warning(f"set_pose refused: {error}")
            return response
        response.success = True
        response.batch_id = sample.batch_id
        response.sample_id = sample.sample_id
        response.stamp = stamp
        response.render_time = sample.render_time_s
        return response

    def _on_command_pose(self, pose: PoseStamped) -> None:
        self._commands.replace([pose])

    def _on_command_trajectory(self, trajectory: MultiDOFJointTrajectory) -> None:
        points, map_frame = self.parameters["trajectory_points"], self.parameters["map_frame"]
        try:
            self._commands.replace(poses_of_trajectory(trajectory, points, map_frame))
        except OaisysError as error:
            self.get_logger().warning(f"command/trajectory refused: {error}")

    def _on_step_batch(self, request: StepBatch.Request, response: StepBatch.Response) -> Any:
        try:
            if request.seed < -1:
                raise InvalidInputError("seed", request.seed, "0 or more, or -1 for the next")
            seed = None if request.seed == -1 else request.seed
            metadata = metadata_of_modules(request.metadata_json)
            world = WorldRequest(seed, request.reuse_stage, metadata)
            response.batch_id = self._simulation.build(world)
            response.success = True
        except OaisysError as error:
            response.message = str(error)
            self.get_logger().warning(f"step_batch refused: {error}")
        return response

    def _on_set_metadata(self, request: SetMetadata.Request, response: SetMetadata.Response) -> Any:
        try:
            metadata = metadata_of_module(request.module, request.metadata_json)
            self._renderer.metadata.add(metadata)
            response.success = True
            response.message = "takes effect at the next sample"
        except OaisysError as error:
            response.message = str(error)
        return response

    def _on_end_simulation(self, _: Trigger.Request, response: Trigger.Response) -> Any:
        try:
            self._configured_link().end_simulation()
            response.success = True
        except OaisysError as error:
            response.message = str(error)
        return response

    def _configured_link(self) -> SimulatorLink:
        if self._link is None:
            raise NotReadyError(f"the bridge is {self.state_name}: configure it first")
        return self._link

    def _ready_link(self) -> tuple[SimulatorLink, SimulatorInfo]:
        """Return the simulator that may render now; look at once for one that was lost.

        Raises:
            NotReadyError: Nothing is rendered now.
        """
        link = self._link
        if link is None or self.aim != ACTIVE:
            raise NotReadyError(f"the bridge is {self.state_name}: activate it first")
        if link.state.info is None:
            link.check()
        if self.reachable() != ACTIVE or not self.wait_for(ACTIVE, ACTIVATION_TIMEOUT_S):
            raise NotReadyError(link.state.reason or f"the bridge is {self.state_name}")
        return link, _known(link)

    def _begin(self, outline: SampleOutline) -> Publication:
        """Begin to publish a sample, with a stamp after that of its batch."""
        self._notice_batch(outline.batch_id)
        return self._topics.begin(outline)

    def _follow(self, before: LinkState, state: LinkState) -> None:
        """Follow what becomes of the simulator: offer its topics, announce its world."""
        if state.info is not None and self.state in (INACTIVE, ACTIVE):
            self._topics.offer(state.info)
        if self._link is not None:
            self._topics.tell_configuration(self._link.config_json)
        if state.info is not None and self.state == ACTIVE:
            self._topics.announce(state.info)
        self._publish_ready()
        self.settle()
        if state.reason == before.reason:
            return
        self._publish_diagnostics()
        address = self.parameters["address"]
        if state.info is not None:
            self.get_logger().info(f"simulator at {address}: {state.reason or 'ready'}")
        else:
            self.get_logger().warning(f"simulator lost: {state.reason}")

    def _notice_batch(self, batch_id: int) -> None:
        """Look at the simulator before a sample of a batch that another client has stepped."""
        link = self._configured_link()
        info = link.state.info
        if info is None or info.batch_id != batch_id:
            link.check()

    def _publish_ready(self) -> None:
        """Say whether a sample can be asked for, where that has changed."""
        with self._ready_lock:
            link = self._link
            ready = link is not None and link.state.ready and self.state == ACTIVE
            if ready != self._announced_ready:
                self._announced_ready = ready
                self._ready.publish(Bool(data=ready))

    def _publish_diagnostics(self) -> None:
        link = self._link
        ready = bool(self._announced_ready)
        meant = self.aim == ACTIVE
        level = DiagnosticStatus.OK if ready else DiagnosticStatus.ERROR
        if not ready and not meant:
            level = DiagnosticStatus.WARN
        counts = self._renderer.counts
        values: dict[str, object] = {
            "address": self.parameters["address"],
            "lifecycle_state": self.state_name,
            FIRST_BATCH_ERROR: "" if link is None else link.first_batch_error,
            FIRST_BATCH_RETRIED: "" if link is None else link.first_batch_retried_after,
            "connections": 0 if link is None else link.state.connections,
            "renderer": self._renderer.activity,
            "queue": self._turns.waiting + self._commands.waiting,
            "rendered": counts.rendered,
            "failed": counts.failed,
            "dropped_commands": self._commands.dropped,
            "last_stamp_ns": counts.last_stamp_ns,
            "last_render_s": counts.last_render_s,
            "last_transfer_s": counts.last_transfer_s,
            "last_publish_s": counts.last_publish_s,
            "memory_mb": resident_mb(),
            **simulator_values(None if link is None else link.state.info),
        }
        for publisher in self.publishers:
            # A caller that must not lose the first sample waits until its subscribers are known.
            values[f"{SUBSCRIBERS}{publisher.topic_name}"] = publisher.get_subscription_count()
        reason = "" if link is None else link.state.reason
        message = "ready" if ready else (reason if meant else "") or self.state_name
        name = f"{self.get_name()}: simulator"
        diagnostics = diagnostics_msg(name, self.parameters["address"], level, message, values)
        diagnostics.status.append(self._readers_status())
        diagnostics.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(diagnostics)

    def _readers_status(self) -> DiagnosticStatus:
        """Return how far the mapper and recorders are."""
        wrong, values = self._readers.diagnostics()
        level = DiagnosticStatus.WARN if wrong else DiagnosticStatus.OK
        name, address = f"{self.get_name()}: readers", self.parameters["address"]
        message = "; ".join(wrong) or "nothing is lost"
        return diagnostics_msg(name, address, level, message, values).status[0]


def _known(link: SimulatorLink) -> SimulatorInfo:
    """Return what is known of the simulator; `NotReadyError` where it is lost."""
    info = link.state.info
    if info is None:
        raise NotReadyError(link.state.reason)
    return info


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node until it is told to end."""
    keep_freed_memory()
    stop = threading.Event()
    return run_node(lambda: BridgeNode(stop), arguments, threads=THREADS, stop=stop)


if __name__ == "__main__":
    sys.exit(main())
