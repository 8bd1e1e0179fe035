"""`posefuse live`: cameras in, 3D skeletons out 100 times a second."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.cli.terminal import Terminal

from .options import add_networks

SUMMARY = "track live: cameras, streams, films or the simulator in, 3D skeletons out 100 times a second"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Rig, sources, outputs."""
    parser.add_argument("rig", type=Path, metavar="RIG", help="calibration file of the cameras")
    parser.add_argument(
        "--source", action="append", default=[], metavar="CAMERA=KIND:WHERE",
        help="one per camera: video:FILE, usb:DEVICE[@640x480@30] (Linux /dev/video0, macOS 0, Windows the name), rtsp://..., "
        "http://..., ros:/TOPIC, realsense:SERIAL, oak:SERIAL; or sim:SCENE|SESSION for all",
    )  # fmt: skip
    add_timing(parser)
    add_outputs(parser)
    add_settings(parser)
    parser.add_argument(
        "--fault", action="append", default=[], metavar="CAMERA=KIND@START[-END]",
        help="let a camera freeze, jump, skew, bump, flood, hang or unplug after START seconds, to test the reaction",
    )  # fmt: skip
    parser.add_argument("--videos", type=Path, metavar="DIR", help="keep the cameras' videos: a session for posefuse track")
    parser.add_argument("--replay", type=Path, metavar="FILE", help="feed a recording to the tracker again, and compare")


def add_timing(parser: argparse.ArgumentParser) -> None:
    """When it ends."""
    parser.add_argument("--duration", type=float, metavar="S", help="stop after so many seconds")
    parser.add_argument("--loop", type=float, metavar="S", help="films and simulated sessions begin again every S seconds")


def add_outputs(parser: argparse.ArgumentParser) -> None:
    """Where results go."""
    parser.add_argument("--record", type=Path, metavar="FILE.mcap", help="record views and poses")
    parser.add_argument("--ros", action="store_true", help="publish in ROS 2")
    parser.add_argument("--osc", action="append", default=[], metavar="HOST:PORT", help="send poses as OSC")
    parser.add_argument("--json-udp", action="append", default=[], metavar="HOST:PORT", help="send poses as JSON datagrams")
    parser.add_argument(
        "--output", action="append", default=[], metavar="NAME",
        help="any other live output, e.g. lsl (see posefuse plugins); options: --set outputs.NAME.KEY=VALUE",
    )  # fmt: skip
    parser.add_argument("--axes", choices=("z_up", "y_up", "y_up_left_handed"), default="z_up", help="axes of OSC and JSON")
    parser.add_argument("--view", action="store_true", help="open the Rerun viewer")
    parser.add_argument("--view-file", type=Path, metavar="FILE.rrd", help="write what the viewer would show to a file")
    parser.add_argument("--report", type=Path, metavar="DIR", help="write where the time went, per camera and stage")
    add_network(parser)


def add_network(parser: argparse.ArgumentParser) -> None:
    """Where ROS 2 is."""
    parser.add_argument("--domain", type=int, default=0, metavar="ID", help="ROS_DOMAIN_ID (default 0)")
    parser.add_argument("--peer", action="append", default=[], metavar="ADDRESS", help="another machine, where multicast is off")
    parser.add_argument("--interface", default="", metavar="NAME", help="network card to use")
    parser.add_argument("--local-only", action="store_true", help="nothing leaves this machine")


def add_settings(parser: argparse.ArgumentParser) -> None:
    """How it works."""
    parser.add_argument("--tracker", choices=("asynchronous", "latest"), help="how views become poses (default asynchronous)")
    parser.add_argument("--people", type=int, metavar="N", help="how many people to follow (default 1)")
    parser.add_argument("--rate", type=float, metavar="HZ", help="poses per second (default 100)")
    parser.add_argument("--groups", type=int, metavar="N", help="camera processes (default: one per two cameras and core)")
    parser.add_argument("--config", type=Path, metavar="FILE", help="TOML settings")
    parser.add_argument("--set", dest="overrides", action="append", default=[], metavar="KEY=VALUE", help="any setting")
    add_networks(parser)


def run(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Run until the time is over, the sources end, or Ctrl-C."""
    from posefuse.cli.live import live

    return live(args, terminal)
