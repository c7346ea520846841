"""Node ``oaisys_drive``: asks the bridge for one drive, and ends with an exit code."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.task import Future
from std_msgs.msg import Bool

from oaisys_core.errors import DeadlineExceededError, InvalidInputError, ShortageError
from oaisys_core.system.ending.signals import (
    RECEIVED,
    end_at_signal,
    ignore_signals,
    interrupt_at_signals,
    raise_if_received,
)
from oaisys_msgs.action import Drive
from oaisys_ros_bridge.bags.recorder_client import RecorderClient
from oaisys_ros_bridge.bridge.requests import drive_changes
from oaisys_ros_bridge.nodes.background_node import BackgroundNode, result_of
from oaisys_ros_bridge.nodes.program_arguments import parse_arguments, program_parser
from oaisys_ros_bridge.qos import LATCHED_QOS

READY, ACTION = "oaisys_bridge/ready", "oaisys_bridge/drive"

START_TIMEOUT_S = 300.0
"""For simulator, bridge and recorder to become ready."""

ANSWER_TIMEOUT_S = 30.0
"""For the bridge to accept or to cancel a drive."""

SAY_PERIOD_S = 2.0
"""Between two lines about the progress."""


class DriveClient(BackgroundNode):
    """Asks for a drive and reports its progress; a context manager.

    Args:
        arguments: Of the program, without its name; ROS's begin with ``--ros-args``.
        wait_for_recorder: Whether to wait until this package's recorder hears the bridge.
    """

    def __init__(self, arguments: Sequence[str], *, wait_for_recorder: bool) -> None:
        super().__init__("oaisys_drive", arguments)
        self._said_s = time.monotonic()
        self._is_ready = False
        self._client = ActionClient(self.node, Drive, ACTION)
        self._recorder = RecorderClient(self) if wait_for_recorder else None
        self.subscribe(Bool, READY, self._on_ready, LATCHED_QOS)
        self.start()

    def drive(self, goal: Drive.Goal) -> Drive.Result:
        """Drive to the end and return the result; cancel the drive if it is interrupted.

        Raises:
            DeadlineExceededError: The bridge or the recorder did not become ready.
        """
        self.wait(READY, lambda: self._is_ready, START_TIMEOUT_S, raise_if_received)
        if self._recorder is not None:
            self._recorder.wait(START_TIMEOUT_S)
        if not self._client.wait_for_server(START_TIMEOUT_S):
            raise DeadlineExceededError(f"nobody offers {ACTION}")
        sent = self._send(lambda: self._client.send_goal_async(goal, self._on_feedback))
        handle = result_of(sent, ACTION, ANSWER_TIMEOUT_S)
        future = self._send(handle.get_result_async)
        future.add_done_callback(self._notify)
        try:
            self.wait("the end of the drive", future.done, float("inf"), raise_if_received)
        except KeyboardInterrupt:
            self._send(handle.cancel_goal_async)
            self.wait("the end of the cancelled drive", future.done, ANSWER_TIMEOUT_S)
        answer = future.result()
        if answer.status == GoalStatus.STATUS_CANCELED:
            say("cancelled")
        return answer.result

    def _send(self, begin: Callable[[], Future]) -> Future:
        return self.send(begin, ACTION, ANSWER_TIMEOUT_S)

    def _on_ready(self, message: Bool) -> None:
        self._is_ready = message.data

    def _notify(self, _: Future) -> None:
        with self.changed:
            self.changed.notify_all()

    def _on_feedback(self, message: Any) -> None:
        now_s = time.monotonic()
        if now_s >= self._said_s + SAY_PERIOD_S:
            self._said_s = now_s
            say(f"{message.feedback.elapsed:.1f} of {message.feedback.duration:.1f} s")


def say(text: str) -> None:
    """Write a line to standard output."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def verdict(result: Drive.Result) -> int:
    """Say what a drive has published; return 0, or 1 if it failed or something is missing."""
    for each in result.sensors:
        say(f"{each.sensor}: {each.made} of {each.due} measurements")
    for each in result.topics:
        say(f"{each.topic}: {each.count} messages")
    if not result.success or result.message:
        sys.stderr.write(f"drive: {result.message or 'failed'}\n")
        return 1
    return 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Drive once; return 0, or 1 if the drive failed or a measurement is missing.

    It returns 2 where ROS cannot use its arguments or ``--drive-json`` is no JSON object, and 128
    and the signal's number where a signal has ended it, after the drive is cancelled.
    """
    about = "Asks the bridge for one drive, says what was measured, and ends with an exit code."
    parser = program_parser("drive", about, "--sensors front --ros-args -r __ns:=/mars")
    parser.add_argument(
        "--drive-json", default="", help="keys of the section `drive` to replace, as a JSON object"
    )
    parser.add_argument(
        "--sensors", nargs="*", default=(), help="sensors that measure; default: all"
    )
    parser.add_argument(
        "--wait-for-recorder",
        action="store_true",
        help="wait until this package's recorder records all that the bridge publishes",
    )
    options, arguments = parse_arguments(parser, arguments)
    goal = Drive.Goal(drive_json=options.drive_json, sensors=[s for s in options.sensors if s])
    code = 1
    try:
        drive_changes(options.drive_json)
        interrupt_at_signals()
        with DriveClient(arguments[1:], wait_for_recorder=options.wait_for_recorder) as client:
            code = verdict(client.drive(goal))
    except (DeadlineExceededError, InvalidInputError, ShortageError) as error:
        sys.stderr.write(f"drive: {error}\n")
        code = 2 if isinstance(error, InvalidInputError) else 1
    except KeyboardInterrupt:
        ignore_signals()
        sys.stderr.write("drive: interrupted before it began\n")
    return 128 + RECEIVED[0] if RECEIVED else code


if __name__ == "__main__":
    exit_code = main()
    if RECEIVED:
        # At Python's end the middleware's threads abort a client that was interrupted while made.
        end_at_signal(RECEIVED[0])
    ignore_signals()
    sys.exit(exit_code)
