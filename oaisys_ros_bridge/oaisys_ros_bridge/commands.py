"""The shell commands ``oaisys record``, ``oaisys bag`` and ``oaisys ros``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

ros_app = typer.Typer(
    help="Describe the ROS interface.", no_args_is_help=True, add_completion=False
)
bag_app = typer.Typer(
    help="List, recover and replay bags.",
    no_args_is_help=True,
    add_completion=False,
)


def record(
    out: Annotated[
        Path | None, typer.Option(help="Folder of the bag, new or empty; otherwise a new bag_DATE.")
    ] = None,
    topic: Annotated[
        list[str] | None,
        typer.Option(help="Topic to wait for and record, repeatable; otherwise all."),
    ] = None,
    everything: Annotated[
        bool, typer.Option("--all", help="Record all other topics, too.")
    ] = False,
    exclude: Annotated[
        str | None,
        typer.Option(
            help="Regular expression of topics to leave out; otherwise compressed images."
        ),
    ] = None,
    duration: Annotated[
        float, typer.Option(help="Length of the recording, seconds; 0: until Ctrl-C.", min=0)
    ] = 0.0,
    namespace: Annotated[str, typer.Option(help="ROS namespace of the topics.")] = "",
    common_tf: Annotated[
        bool,
        typer.Option(
            "--common-tf", help="With --namespace: TF is /tf all the same, as with frame_prefix."
        ),
    ] = False,
) -> None:
    """Record topics to a rosbag2 MCAP bag; prints `recording: BAG` once it is subscribed."""
    from oaisys_ros_bridge.namespaces import namespace_arguments, require_namespace
    from oaisys_ros_bridge.nodes.recorder import run_recorder

    require_namespace(namespace)
    given = {"path": str(out or ""), "topics": ["", *(topic or [])], "all": everything}
    rules = namespace_arguments(namespace, has_own_tf=not common_tf)
    given |= {"duration_s": duration} | ({} if exclude is None else {"exclude": exclude})
    raise typer.Exit(run_recorder(["record", *rules], **given))


@bag_app.command("info")
def bag_info(
    bag: Annotated[Path, typer.Argument(help="A bag's folder or its .mcap file.")],
) -> None:
    """List a bag's topics, types and message counts."""
    from oaisys_core.system.standard_streams import printable
    from oaisys_ros_bridge.bags.info import summary_of

    for line in summary_of(bag):
        typer.echo(printable(line))


@bag_app.command("recover")
def bag_recover(
    bag: Annotated[Path, typer.Argument(help="A bag's folder or its .mcap file.")],
    out: Annotated[
        Path | None, typer.Option(help="Folder of the new bag; otherwise beside the old one.")
    ] = None,
) -> None:
    """Copy the messages of a bag that was cut short or is damaged to a new, complete bag.

    What cannot be read is skipped, and told on standard error.
    """
    from oaisys_ros_bridge.bags.reading import mcap_file, recover

    file = mcap_file(bag)
    folder = bag if bag.is_dir() else bag.with_suffix("")
    target = out or folder.with_name(f"{folder.name}_recovered")
    copied = recover(file, target, lambda loss: typer.echo(f"lost: {loss}", err=True))
    typer.echo(f"{target}: {copied} messages")


@bag_app.command("replay")
def bag_replay(
    bag: Annotated[Path, typer.Argument(help="A bag's folder or its .mcap file.")],
    rate: Annotated[
        float, typer.Option(help="Speed, as a multiple of the recorded one.", min=1e-3, max=1e3)
    ] = 1.0,
    loop: Annotated[bool, typer.Option("--loop", help="Start again at the end.")] = False,
    topics: Annotated[
        list[str] | None, typer.Option(help="Topic to publish, repeatable; otherwise all.")
    ] = None,
    clock: Annotated[
        float,
        typer.Option(
            help="Rate at which the recording's time is published on /clock, Hz; 0: never.",
            min=0,
            max=1e3,
        ),
    ] = 0.0,
    remap: Annotated[
        list[str] | None, typer.Option(help="Rename a topic, FROM:=TO, repeatable.")
    ] = None,
    wait_for: Annotated[
        int, typer.Option(help="Start when this many nodes read any of the topics.", min=0)
    ] = 0,
    wait_for_topic: Annotated[
        list[str] | None, typer.Option(help="Topic that must have a reader first, repeatable.")
    ] = None,
    wait_timeout: Annotated[
        float, typer.Option(help="Longest time to wait for readers, seconds.", min=0, max=86_400)
    ] = 10.0,
    delay: Annotated[
        float,
        typer.Option(
            help="Start after this many seconds, with or without readers; with --wait-for or "
            "--wait-for-topic, this long after these readers have come.",
            min=0,
        ),
    ] = 0.0,
) -> None:
    """Publish the messages of a bag with their recorded quality of service.

    It starts when each topic of --topics or --wait-for-topic has a reader and --wait-for nodes
    read; without these options, when every topic has a reader, or after --wait-timeout if any has
    one. --delay alone waits for no reader. At the end it prints how many messages and readers each
    topic had. Exit 1 if the readers did not come.
    """
    from oaisys_ros_bridge.nodes.player import main as play

    _require_one_name_each(remap or ())
    rules = [part for rule in remap or () for part in ("-r", rule)]
    arguments = ["replay", *(["--ros-args", *rules] if rules else [])]
    given = {"path": str(bag), "rate": rate, "loop": loop, "clock_hz": clock, "delay_s": delay}
    given |= {"wait_for_readers": wait_for, "wait_timeout_s": wait_timeout}
    given |= {"topics": ["", *(topics or [])], "wait_for_topics": ["", *(wait_for_topic or [])]}
    raise typer.Exit(play(arguments, **given))


def _require_one_name_each(rules: Sequence[str]) -> None:
    """Refuse two rules for one topic, of which ROS would follow the first and drop the other."""
    counts = Counter(rule.partition(":=")[0] for rule in rules)
    if twice := [rule for rule in rules if counts[rule.partition(":=")[0]] > 1]:
        message = f"received {', '.join(twice)}, expected one rule for each topic"
        raise typer.BadParameter(message, param_hint="--remap")


@ros_app.callback()
def _ros() -> None:
    """Describe the ROS interface."""


@ros_app.command("reference")
def ros_reference(
    out: Annotated[
        Path | None, typer.Option(help="File to write; otherwise standard output.")
    ] = None,
) -> None:
    """Write the reference page of all topics, services, actions and parameters."""
    from oaisys_core.files.whole_files import write_whole_text
    from oaisys_ros_bridge.parameters.reference import reference_text

    text = reference_text()
    if out is None:
        typer.echo(text, nl=False)
    else:
        write_whole_text(out, text)
