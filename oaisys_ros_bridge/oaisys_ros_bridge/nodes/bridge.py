"""Node ``oaisys_bridge``: pose requests in, samples of the simulator out."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from std_srvs.srv import Trigger

from oaisys_core.errors import InvalidInputError, NotReadyError, OaisysError
from oaisys_grpc.client.simulator_client import client_tls
from oaisys_grpc.memory import IdleMemory, keep_freed_memory
from oaisys_msgs.srv import GetNewestSample, SetMetadata, SetPose, StepBatch
from oaisys_ros_bridge.bridge.back_pressure import BackPressure
from oaisys_ros_bridge.bridge.drives import drive_server
from oaisys_ros_bridge.bridge.ground_services import GroundServices
from oaisys_ros_bridge.bridge.link_state import LinkChange
from oaisys_ros_bridge.bridge.metadata import metadata_of_module, metadata_of_modules
from oaisys_ros_bridge.bridge.pose_commands import PoseCommands, sweep_server
from oaisys_ros_bridge.bridge.render_queue import RenderQueue
from oaisys_ros_bridge.bridge.requests import ViewRequest
from oaisys_ros_bridge.bridge.simulator_link import SimulatorLink
from oaisys_ros_bridge.bridge.status import BridgeStatus
from oaisys_ros_bridge.bridge.true_ground import TrueGround
from oaisys_ros_bridge.bridge.world_topics import WorldTopics
from oaisys_ros_bridge.conversions import duration_from_seconds
from oaisys_ros_bridge.nodes.managed_node import (
    ACTIVE,
    FINALIZED,
    INACTIVE,
    UNCONFIGURED,
    ManagedNode,
)
from oaisys_ros_bridge.nodes.node_process import run_node
from oaisys_ros_bridge.nodes.program_arguments import node_parser, parse_arguments
from oaisys_ros_bridge.parameters.bridge import BRIDGE
from oaisys_ros_bridge.parameters.node_parameters import ParameterNode
from oaisys_ros_bridge.parameters.table import Changeable, ParameterRow
from oaisys_ros_bridge.publishing.ground_topics import GroundTopics
from oaisys_ros_bridge.services import NodeServices
from oaisys_ros_bridge.simulation_interfaces.simulation_control import SimulationControl
from oaisys_ros_bridge.simulation_interfaces.worlds import WorldRequest
from oaisys_ros_bridge.timers import steady_timer

if TYPE_CHECKING:
    from oaisys_ros_bridge.simulation_interfaces.services import SimulationServices

LOOK_PERIOD_S = 1.0
"""Between two diagnostics, and two looks at the memory that can be given back."""
REFUSAL = "the bridge is {}: activate it first"
THREADS = 12
"""Enough for one goal of each action and a command to wait for their turns while everything else
goes on; requests of services wait in queues of their own."""


class BridgeNode(ParameterNode, ManagedNode):
    """Renders requested views one at a time and publishes them.

    A managed node: configured, it knows the simulator and offers its topics; active, it renders.
    By default it becomes active by itself, and again whenever the simulator has come back.
    Its parameters are the rows of `oaisys_ros_bridge.parameters.bridge.BRIDGE`.

    Args:
        stop: Set once somebody has shut the node down for good.
    """

    def __init__(self, stop: threading.Event) -> None:
        super().__init__("oaisys_bridge")
        self.declare_table(BRIDGE)
        self._stop = stop
        self._memory = IdleMemory()
        self._rendered_before = 0
        self._changed = self.create_guard_condition(
            self._follow_changes, callback_group=MutuallyExclusiveCallbackGroup()
        )
        back_pressure = BackPressure(self, self._settings)
        self._topics = WorldTopics(self, self._settings, back_pressure)
        self._render_queue = RenderQueue(
            self._topics, back_pressure, self._settings, on_sample=self._on_sample
        )
        self._render_queue.refusal = REFUSAL.format("unconfigured")
        self._commands = PoseCommands(self, self._render_queue, self._settings)
        self._status = BridgeStatus(self, self._render_queue, self._settings, self._topics.now)
        self._goals = [
            sweep_server(self, self._render_queue),
            drive_server(self, self._render_queue, self._topics),
        ]
        self._node_services = NodeServices(self)
        GroundServices(self, self._node_services, self._render_queue, self._topics.now)
        ground = TrueGround(self._render_queue)
        self._ground_topics = GroundTopics(
            self, "ground_truth/", ground.newest_view, ground.find, self._settings
        )
        self._simulation = SimulationControl(self._render_queue, self._topics)
        self._simulation_services = self._simulation_interfaces()
        self._offer_services()
        self._status.publish_ready()
        if self.parameters["autostart"]:
            self._render_queue.refusal = ""
            self._start_link(self._new_link())
            self.set_aim(ACTIVE)

    def close(self) -> None:
        """Stop rendering and disconnect from the simulator."""
        self._render_queue.refusal = "the bridge ends"
        self.stop_rendering("the bridge ends")
        if self._render_queue.link is not None:
            self._render_queue.link.close()
        self._node_services.close()

    def configure(self) -> None:
        """Find the simulator and offer its topics."""
        link = self._render_queue.link
        if link is None:
            link = self._new_link()
            try:
                self._topics.offer(link.find())
            except OaisysError:
                link.close()
                raise
            self._topics.publish_configuration(link.config_json)
            self._start_link(link)
        else:
            self._topics.offer(link.info)
        if not self.by_itself:
            self._render_queue.refusal = REFUSAL.format("inactive")

    def activate(self) -> None:
        """Make sure that there is a world, announce it, and render."""
        link = self._render_queue.require_link()
        if not link.state.ready:
            link.check()
        if not link.state.ready:
            raise NotReadyError(link.state.reason)
        self._topics.announce(link.info)
        self._render_queue.refusal = ""
        self._render_queue.active.set()

    def deactivate(self) -> None:
        """Stop rendering; refuse requests unless the simulator was only lost."""
        if not self.by_itself:
            self._render_queue.refusal = REFUSAL.format("inactive")
        self._render_queue.active.clear()
        self.stop_rendering("the bridge was deactivated")

    def cleanup(self) -> None:
        """Disconnect and withdraw the topics, unless the simulator was only lost."""
        self._render_queue.forget_world()
        self._simulation.forget()
        if self.by_itself:
            return
        self._render_queue.refusal = REFUSAL.format("unconfigured")
        link, self._render_queue.link = self._render_queue.link, None
        if link is not None:
            link.close()
        self._topics.withdraw()

    def reachable(self) -> int:
        """Return the highest state that the simulator allows; the active state needs a world."""
        link = self._render_queue.link
        if link is None or link.state.info is None:
            return UNCONFIGURED
        return ACTIVE if link.state.ready or self.state == ACTIVE else INACTIVE

    def on_settled(self) -> None:
        """Publish the new state; end the process after a shutdown."""
        self._status.publish_ready()
        self._status.publish_diagnostics()
        if self.state == FINALIZED:
            self._stop.set()

    def reason_against(self, row: ParameterRow) -> str:
        """Return why a parameter cannot be set now, or nothing."""
        if row.changeable is Changeable.UNCONFIGURED and self.state != UNCONFIGURED:
            return f"no change while the bridge is {self.state_name}: clean it up first"
        return super().reason_against(row)

    def on_parameters(self, changed: Mapping[str, Any]) -> None:
        """Apply new values of the parameters that are read only once."""
        link = self._render_queue.link
        if link is None:
            return
        link.initial_batch = self.parameters["initial_batch"]
        unconfigured = {row.name for row in BRIDGE if row.changeable is Changeable.UNCONFIGURED}
        if unconfigured & changed.keys():
            link.close()
            self._start_link(self._new_link())

    def stop_rendering(self, reason: str) -> None:
        """Cancel the render under way, the actions, and commands that wait."""
        self._commands.clear()
        for goals in self._goals:
            goals.stop(reason)
        if self._simulation_services is not None:
            self._simulation_services.stop(reason)
        self._render_queue.stop(reason)

    def _on_sample(self) -> None:
        self._changed.trigger()
        self._ground_topics.note_view()

    def _settings(self) -> Mapping[str, Any]:
        return self.parameters

    def _new_link(self) -> SimulatorLink:
        values = self.parameters
        return SimulatorLink(
            values["address"],
            initial_batch=values["initial_batch"],
            timeout_s=values["timeout_s"],
            on_change=self._changed.trigger,
            tls=client_tls(values["tls_ca"], values["tls_cert"], values["tls_key"]),
        )

    def _start_link(self, link: SimulatorLink) -> None:
        self._render_queue.link = link
        link.start()

    def _simulation_interfaces(self) -> SimulationServices | None:
        """Offer the services if they are wanted and their types are installed."""
        if not self.parameters["simulation_interfaces"]:
            return None
        try:
            from oaisys_ros_bridge.simulation_interfaces.services import SimulationServices
        except ImportError as error:
            self.get_logger().warning(f"simulation_interfaces are not offered: {error}")
            return None
        return SimulationServices(
            self, self._node_services, self._simulation, self._render_queue, self._settings
        )

    def _offer_services(self) -> None:
        """Offer the services, each with a queue of its own, as each may wait for its turn."""
        offered: tuple[tuple[Any, str, Callable[..., Any]], ...] = (
            (SetPose, "~/set_pose", self._on_set_pose),
            (StepBatch, "~/step_batch", self._on_step_batch),
            (SetMetadata, "~/set_metadata", self._on_set_metadata),
            (Trigger, "~/end_simulation", self._on_end_simulation),
            (GetNewestSample, "~/get_newest_sample", lambda *_: self._topics.newest_sample),
        )
        for kind, name, callback in offered:
            self._node_services.offer(kind, name, callback)
        steady_timer(self, LOOK_PERIOD_S, self._look)

    def _on_set_pose(self, request: SetPose.Request, response: SetPose.Response) -> Any:
        try:
            view = ViewRequest(request.pose, request.sensor, request.modalities)
            sample, stamp = self._render_queue.render(view)
        except OaisysError as error:
            response.message = str(error)
            self.get_logger().warning(f"set_pose failed: {error}")
            return response
        response.success = True
        response.batch_id = sample.batch_id
        response.sample_id = sample.sample_id
        response.stamp = stamp
        response.render_time = sample.render_time_s
        response.render_duration = duration_from_seconds(sample.render_time_s)
        return response

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
            self.get_logger().warning(f"step_batch failed: {error}")
        return response

    def _on_set_metadata(self, request: SetMetadata.Request, response: SetMetadata.Response) -> Any:
        try:
            metadata = metadata_of_module(request.module, request.metadata_json)
            self._render_queue.metadata.add(metadata)
            response.success = True
            response.message = "takes effect at the next sample"
        except OaisysError as error:
            response.message = str(error)
        return response

    def _on_end_simulation(self, _: Trigger.Request, response: Trigger.Response) -> Any:
        try:
            self._render_queue.require_link().end_simulation()
            response.success = True
        except OaisysError as error:
            response.message = str(error)
        return response

    def _look(self) -> None:
        """Publish diagnostics; give freed memory back once nothing was rendered for a period."""
        self._status.publish_diagnostics()
        rendered = self._render_queue.counts.rendered
        if self._render_queue.activity == "idle" and rendered == self._rendered_before:
            self._memory.give_back()
        self._rendered_before = rendered

    def _follow_changes(self) -> None:
        """Publish the changes of the simulator, and diagnostics, since the last call."""
        link = self._render_queue.link
        while link is not None and not link.changes.empty():
            self._follow(link, link.changes.get())
        self._status.publish_diagnostics()

    def _follow(self, link: SimulatorLink, change: LinkChange) -> None:
        info, reason = change.after.info, change.after.reason
        self._topics.publish_configuration(link.config_json)
        self._render_queue.update_topics()
        self._status.publish_ready()
        self.settle()
        if reason == change.before.reason:
            return
        self._status.publish_diagnostics(reason)
        if info is not None and reason and link.first_batch_error:
            self.get_logger().warning(f"simulator at {link.address}: {reason}")
        elif info is not None:  # rclpy wants a line of its own for each severity
            self.get_logger().info(f"simulator at {link.address}: {reason or 'ready'}")
        else:
            state = "waiting for the simulator" if change.before.info is None else "simulator lost"
            self.get_logger().warning(f"{state}: {reason}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node until it is told to end."""
    _, arguments = parse_arguments(node_parser("bridge"), arguments)
    keep_freed_memory()
    stop = threading.Event()
    return run_node(lambda: BridgeNode(stop), arguments, threads=THREADS, stop=stop)


if __name__ == "__main__":
    sys.exit(main())
