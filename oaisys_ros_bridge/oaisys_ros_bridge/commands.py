"""The shell commands ``oaisys record``, ``oaisys bag`` and ``oaisys ros``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

ros_app = typer.Typer(
    help="Describe the ROS interface.", no_args_is_help=True, add_completion=False
)
bag_app = typer.Typer(
    help="Look into bags, mend them, publish them again.",
    no_args_is_help=True,
    add_completion=False,
)


def record(
    out: Annotated[
        Path | None, typer.Option(help="Folder of the bag, new or empty; else a new bag_DATE.")
    ] = None,
    topic: Annotated[
        list[str] | None,
        typer.Option(help="Topic to wait for and to record, repeatable; all where none is given."),
    ] = None,
    everything: Annotated[
        bool, typer.Option("--all", help="Record all others beside --topic, too.")
    ] = False,
    exclude: Annotated[
        str | None, typer.Option(help="Expression of topics to leave out; else compressed images.")
    ] = None,
    duration: Annotated[float, typer.Option(help="Seconds; 0: until Ctrl-C.", min=0)] = 0.0,
    namespace: Annotated[str, typer.Option(help="Record what is in there.")] = "",
) -> None:
    """Record topics as a rosbag2 MCAP; prints `recording: BAG` once it listens to them."""
    from oaisys_ros_bridge.namespaces import namespace_arguments, require_namespace
    from oaisys_ros_bridge.nodes.recorder import run_recorder

    require_namespace(namespace)
    given = {"path": str(out or ""), "topics": ["", *(topic or [])], "all": everything}
    given |= {"duration_s": duration} | ({} if exclude is None else {"exclude": exclude})
    raise typer.Exit(run_recorder(["record", *namespace_arguments(namespace)], **given))


@bag_app.command("info")
def bag_info(
    bag: Annotated[Path, typer.Argument(help="A bag's folder or its .mcap file.")],
) -> None:
    """List a bag's topics, types and message counts."""
    from oaisys_ros_bridge.bags.info import summary_of

    for line in summary_of(bag):
        typer.echo(line)


@bag_app.command("recover")
def bag_recover(
    bag: Annotated[Path, typer.Argument(help="A bag's folder or its .mcap file.")],
    out: Annotated[
        Path | None, typer.Option(help="Folder of the new bag; else beside the old one.")
    ] = None,
) -> None:
    """Copy what a recorder that was killed had written into a bag that opens everywhere."""
    from oaisys_ros_bridge.bags.info import mcap_file
    from oaisys_ros_bridge.bags.recovery import recover

    file = mcap_file(bag)
    folder = bag if bag.is_dir() else bag.with_suffix("")
    target = out or folder.with_name(f"{folder.name}_recovered")
    typer.echo(f"{target}: {recover(file, target)} messages")


@bag_app.command("replay")
def bag_replay(
    bag: Annotated[Path, typer.Argument(help="A bag's folder or its .mcap file.")],
    rate: Annotated[
        float, typer.Option(help="How much faster than recorded.", min=1e-3, max=1e3)
    ] = 1.0,
    loop: Annotated[bool, typer.Option("--loop", help="Begin again at the end.")] = False,
    topics: Annotated[
        list[str] | None, typer.Option(help="A topic to publish, repeatable; else all.")
    ] = None,
    clock: Annotated[
        float, typer.Option(help="Hz at which /clock tells the recording's time.", min=0, max=1e3)
    ] = 0.0,
    remap: Annotated[
        list[str] | None, typer.Option(help="FROM:=TO, another name for a topic, repeatable.")
    ] = None,
    wait_for: Annotated[
        int, typer.Option(help="Begin when so many readers are there, of all topics.", min=0)
    ] = 0,
    wait_for_topic: Annotated[
        list[str] | None, typer.Option(help="A topic that must have a reader first, repeatable.")
    ] = None,
    wait_timeout: Annotated[
        float, typer.Option(help="Seconds that readers may take to come.", min=0, max=86_400)
    ] = 10.0,
    delay: Annotated[
        float, typer.Option(help="Begin after so many seconds, whoever is there.", min=0)
    ] = 0.0,
) -> None:
    """Publish a bag again, with the quality of service that it was recorded with.

    It begins when each topic of --topics or --wait-for-topic has a reader and --wait-for readers
    are there; without these options, when every topic has one, or with those that have come by
    --wait-timeout. At the end it tells what was sent on each topic, and who read it; exit 1 where
    the readers did not come.
    """
    from oaisys_ros_bridge.nodes.player import main as play

    rules = [part for rule in remap or () for part in ("-r", rule)]
    arguments = ["replay", *(["--ros-args", *rules] if rules else [])]
    given = {"path": str(bag), "rate": rate, "loop": loop, "clock_hz": clock, "delay_s": delay}
    given |= {"wait_for_readers": wait_for, "wait_timeout_s": wait_timeout}
    given |= {"topics": ["", *(topics or [])], "wait_for_topics": ["", *(wait_for_topic or [])]}
    raise typer.Exit(play(arguments, **given))


@ros_app.callback()
def _ros() -> None:
    """Describe the ROS interface."""


@ros_app.command("reference")
def ros_reference(
    out: Annotated[Path | None, typer.Option(help="File to write; else it is printed.")] = None,
) -> None:
    """Write the page that lists every topic, service, action and parameter of the nodes."""
    from oaisys_ros_bridge.parameters.reference import reference_text

    text = reference_text()
    if out is None:
        typer.echo(text, nl=False)
    else:
        out.write_text(text, encoding="utf-8")
