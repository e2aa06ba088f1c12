"""The parsers of `edge trajectory`, `worlds`, `bench` and `soak`: commands of `edge.lab`."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge.cli.options import (
    CONFIG,
    config_argument,
    count,
    dispatch_on_option,
    flag,
    lazy_handler,
    positive,
    seed,
    trust_option,
)


# fmt: off
def add_trajectory(commands) -> None:  # type: ignore[no-untyped-def]
    """Add `edge trajectory`."""
    trajectory = commands.add_parser(
        "trajectory", help="make a trajectory from one instruction, camera image and LiDAR scan"
    )
    option = trajectory.add_argument
    option("place", metavar="PLACE", help="folder of a SemanticKITTI sequence, or street:N for "
           "the built-in street number N")
    option("instruction", metavar="WORDS", help="the task in words, such as 'go past the left of "
           "the van, then stop at the bench'")
    option("--frames", type=int, nargs="+", default=[], metavar="N", help="numbers of the frames "
           "to use; the robot is at the last one (default: the first frame)")
    option("--objects", choices=("labels", "detector"), default="labels",
           help="source of the objects: labels of the data, or the detector of --config")
    option("--config", default="street", help=CONFIG)
    option("--url", help="let the model of this OpenAI-compatible server write the trajectory, "
           "such as http://HOST:PORT/v1 (default: built-in rules write it)")
    option("--model", metavar="NAME", help="with --url: the model's name on the server")
    option("--out", default="trajectory", metavar="DIR",
           help="folder for the trajectory, its pictures and a web page (default: ./%(default)s)")
    trajectory.set_defaults(handler=lazy_handler("edge.lab.eval.trial.command", extra="lab"))


def add_worlds(commands) -> None:  # type: ignore[no-untyped-def]
    """Add `edge worlds`."""
    worlds = commands.add_parser("worlds", help="bring a building of your own to the simulator")
    kinds = worlds.add_subparsers(title="verbs", required=True, metavar="VERB")
    importing = kinds.add_parser(
        "import", help="turn a Gazebo world (SDF) with its models into a mesh and named objects"
    )
    option = importing.add_argument
    option("world", type=Path, metavar="WORLD", help="world file (.world or .sdf)")
    option("--models", type=Path, action="append", metavar="DIR", help="folder that has the "
           "models; may be repeated; nothing outside of these folders and of the world's own is "
           "read (default: the folders in $GAZEBO_MODEL_PATH and $GZ_SIM_RESOURCE_PATH)")
    option("--out", type=Path, required=True, metavar="DIR", help="folder for the mesh (.glb), "
           "objects (.objects.json), names (.names.yaml) and a configuration (.yaml)")
    option("--floor", type=float, default=0.0, metavar="Z",
           help="height of the floor in the world file, in m (default: 0)")
    importing.set_defaults(handler=lazy_handler("edge.lab.sim.gazebo.convert", extra="worlds"))


def add_bench(commands) -> None:  # type: ignore[no-untyped-def]
    """Add `edge bench`."""
    bench = commands.add_parser(
        "bench", help="measure the latency of the service, or compare models"
    )
    config_argument(bench, "cpu")
    bench.add_argument("--json", type=Path, metavar="FILE",
                       help="also write the results to this file, as JSON")
    group = bench.add_argument_group("the service")
    option = group.add_argument
    option("--seconds", type=positive, default=60, metavar="N", help="how long to measure, in s")
    flag(group, "--enforce", "return exit code 1 if a result is over its budget")
    flag(group, "--calibrate", "only measure the speed of this computer, and save it: later "
         "budgets are scaled to it")
    option("--recording", metavar="FILE", help="MCAP file to play (default: a simulated run, which "
           "the first `edge bench` makes)")
    trust_option(bench)
    group = bench.add_argument_group("compare models on the same images")
    option = group.add_argument
    option("--models", nargs="?", const="", metavar="FAMILY", help="compare the detectors of this "
           "family (default: the family of the configured detector)")
    option("--images", type=Path, metavar="DIR",
           help="folder of images (default: images of a simulated house)")
    option("--frames", type=count, default=50, metavar="N", help="number of images")
    option("--providers", metavar="LIST", help="where to run the models: cpu, cuda, ort-tensorrt "
           "(TensorRT in onnxruntime) or tensorrt (without onnxruntime), with commas between "
           "(default: all that work here)")
    option("--threads", type=count, metavar="N",
           help="number of CPU threads (default: perception.detector.threads)")
    dispatch_on_option(
        bench, "--models", on=lazy_handler("edge.lab.bench.compare"),
        on_only=("--images", "--providers", "--threads"),
        off=_bench_service,
        off_only=("--enforce", "--calibrate", "--recording", "--trust-cache"),
    )


def add_soak(commands) -> None:  # type: ignore[no-untyped-def]
    """Add `edge soak`."""
    soak = commands.add_parser(
        "soak",
        help="run the service and a simulated robot for hours, inject faults, and check the "
        "service",
    )
    config_argument(soak, "soak")
    option = soak.add_argument
    option("--minutes", type=positive, default=120, metavar="N", help="duration in minutes")
    option("--seed", type=seed, default=0, help="seed of the faults and missions")
    option("--faults", metavar="NAME,NAME,…", help="inject only these faults of docs/soak.md "
           "(default: all that the configuration allows)")
    option("--out", type=Path, default=Path("soak"), metavar="FOLDER",
           help="folder for the recordings and logs (default: ./%(default)s)")
    soak.set_defaults(handler=lazy_handler("edge.lab.eval.soak.run", extra="lab"))
# fmt: on


def _bench_service(args: argparse.Namespace) -> int:
    """Handle `edge bench`: check the configuration before the recording, which takes a while."""
    if not args.calibrate:
        from edge.cli.preflight import check
        from edge.config import load

        check(load(args.config))
    return lazy_handler("edge.lab.bench.service")(args)
