"""The parser of `edge eval`: its kinds and their arguments."""

from __future__ import annotations

from pathlib import Path

from edge.cli.options import (
    CONFIG,
    cores,
    count,
    dispatch_on_option,
    lazy_handler,
    probabilities,
    seed,
    share,
)


def add(commands) -> None:  # type: ignore[no-untyped-def]
    """Add `eval` and its kinds."""
    evaluate = commands.add_parser(
        "eval", help="evaluate episodes, planners, translators, trajectories"
    )
    kinds = evaluate.add_subparsers(title="kinds", required=True, metavar="KIND")
    _episodes(kinds)
    _planning(kinds)
    _translate(kinds)
    _trajectories(kinds)
    _rooms(kinds)


def _episodes(kinds) -> None:  # type: ignore[no-untyped-def]
    episodes = kinds.add_parser(
        "episodes", help="compare policies on find-the-object episodes in simulated time"
    )
    episodes.add_argument("config", nargs="?", default="demo", help=f"{CONFIG} (default: demo)")
    group = episodes.add_argument_group("episodes to run")
    option, task = group.add_argument, group.add_mutually_exclusive_group().add_argument
    option(
        "--episodes", type=Path, metavar="FILE",
        help="run the episodes of a file that --plan wrote; of the other options in this group, "
        "only --limit then has an effect",
    )  # fmt: skip
    option("--plan", type=Path, metavar="FILE", help="write the episodes to this file and stop")
    option(
        "--worlds", nargs="+", metavar="WORLDS",
        help="FILE.jsonl.gz[0:75], generated[1000:1050], house:NAME or MESH.glb,OBJECTS.json; "
        "default: the world of the configuration",
    )  # fmt: skip
    option(
        "--targets", metavar="NAME,NAME,…",
        help="objects to find, or `common` (default with --worlds): sixteen large objects of most "
        "homes; a world without an object has no episode with it",
    )  # fmt: skip
    option(
        "--starts",
        type=count,
        default=4,
        help="starts for each target and world (default: %(default)s)",
    )
    option("--per-world", type=count, metavar="N", help="at most N random episodes for each world")
    task(
        "--missions", type=count, metavar="N",
        help="instead, N missions for each world, with two to four targets, in order or by choice",
    )  # fmt: skip
    task(
        "--goals", type=count, metavar="N",
        help="instead, one session for each world: N of the targets one after another, with and "
        "without memory of the goals before",
    )  # fmt: skip
    option(
        "--moved", type=share, default=0.0, metavar="SHARE",
        help="with --goals: share of the movable objects that move between two goals (default: 0)",
    )  # fmt: skip
    task(
        "--zones", action="store_true",
        help="put a random keep-out zone on the shortest path of each episode",
    )  # fmt: skip
    task(
        "--ask", action="store_true",
        help="instead, one episode for each world: explore it, then ask where the targets are",
    )  # fmt: skip
    option("--limit", type=count, metavar="N", help="only the first N episodes")
    option("--seed", type=int, default=0, help="seed of the random choices (default: %(default)s)")
    option(
        "--min-distance", type=float, default=4.0, metavar="M",
        help="shortest driving distance from start to target, in m (default: %(default)g)",
    )  # fmt: skip
    option = episodes.add_argument_group("arms to compare").add_argument
    option(
        "--arm", nargs="+", action="append", metavar=("NAME", "KEY=VALUE"),
        help="name of an arm, and its changes of the configuration: "
        "--arm near policy.kind=nearest_frontier; may be repeated",
    )  # fmt: skip
    option(
        "--arms", type=Path, metavar="FILE",
        help="arms from a YAML file: name: {policy: {kind: …}}; `config:` in an arm names "
        "another configuration to change",
    )  # fmt: skip
    option = episodes.add_argument_group("how to run").add_argument
    option(
        "--out", type=Path, metavar="DIR",
        help="write outcomes.jsonl and episodes.jsonl there; what they contain is not run again",
    )  # fmt: skip
    option(
        "--report", type=Path, metavar="DIR",
        help="as --out, with a report and pictures of every episode that is run",
    )  # fmt: skip
    option(
        "--workers", "--jobs", type=count, default=1, metavar="N",
        help="number of processes, of one thread each (default: only this one)",
    )  # fmt: skip
    option(
        "--processes", action="store_true",
        help="run robot, controller and service as separate processes, over Zenoh",
    )  # fmt: skip
    option = episodes.add_argument_group("results").add_argument
    option(
        "--compare", type=Path, metavar="DIR",
        help="run nothing; make tables, plots and maps from a folder that --out filled",
    )  # fmt: skip
    option(
        "--baseline", metavar="NAME",
        help="arm that the others are compared with (default: the first)",
    )  # fmt: skip
    compare = lazy_handler("edge.lab.eval.comparison.run", "run", lab=True)
    runs = lazy_handler("edge.lab.eval.runs", "run", lab=True)
    only_runs = ("--episodes", "--plan", "--worlds", "--arm", "--arms", "--out", "--report")
    dispatch_on_option(
        episodes, "--compare", on=compare, on_only=("--baseline",), off=runs, off_only=only_runs
    )


_P_OBS = "0.1,0.2,0.3,0.4,0.5,0.6,0.7,0.8,0.9,1.0"


def _planning(kinds) -> None:  # type: ignore[no-untyped-def]
    planning = kinds.add_parser(
        "planning", help="evaluate mission planners on tasks in language (ViTL figure 4)"
    )
    option = planning.add_argument
    option("--tasks", type=Path, metavar="FILE", help="read the tasks from this file (JSON lines)")
    option("--export", type=Path, metavar="FILE", help="write the tasks to this file and stop")
    option(
        "--n", type=count, default=2000, help="number of tasks to generate (default: %(default)s)"
    )
    option(
        "--seed", type=seed, default=0, help="seed of tasks and of chance (default: %(default)s)"
    )
    option(
        "--p-obs", type=probabilities, default=_P_OBS, metavar="P,P,…",
        help="probabilities that an exploration finds its target (default: 0.1,0.2,…,1.0)",
    )  # fmt: skip
    option(
        "--planners",
        metavar="NAME,NAME,…",
        help="planners; default: all that need no language model",
    )
    option("--episodes", type=count, default=1, help="per task and p_obs (default: %(default)s)")
    option(
        "--jobs", type=count, default=cores(), help="number of processes (default: one per core)"
    )
    option(
        "--out", type=Path, default=Path("planning-report"), metavar="DIR",
        help="folder for plots and results.json (default: ./%(default)s)",
    )  # fmt: skip
    option(
        "--llm",
        metavar="URL",
        help="compare a language model on this OpenAI-compatible server, too",
    )
    option(
        "--model", default="default", help="name of the model on the server (default: %(default)s)"
    )
    option(
        "--llm-tasks", type=count, default=20, metavar="N",
        help="number of tasks for the language model (default: %(default)s)",
    )  # fmt: skip
    planning.set_defaults(handler=lazy_handler("edge.lab.eval.planning.run", "run", lab=True))


def _translate(kinds) -> None:  # type: ignore[no-untyped-def]
    translate = kinds.add_parser(
        "translate", help="evaluate the translation of instructions to formulas"
    )
    option = translate.add_argument
    option(
        "--backend", nargs="+", choices=("grammar", "model", "auto", "llm"),
        default=("grammar", "model", "auto"), metavar="NAME",
        help="translators to score: grammar, model, auto, llm (default: all but llm)",
    )  # fmt: skip
    option("--url", help="for --backend llm: URL of the OpenAI-compatible server")
    option("--model", help="for --backend llm: name of the model")
    option(
        "--constrain", choices=("gbnf", "guided_grammar", "none"), default="none",
        help="for --backend llm: how the server gets the grammar of the formulas",
    )  # fmt: skip
    option("--limit", type=count, metavar="N", help="at most N instructions of each set")
    option("--seed", type=int, default=0, help="seed of the benchmark's tasks (default: 0)")
    option(
        "--lang2ltl", type=Path, metavar="CSV",
        help="Lang2LTL's symbolic utterances (symbolic_batch12_noperm.csv); without it that set "
        "is skipped",
    )  # fmt: skip
    option(
        "--clean-up", type=Path, metavar="JSONL",
        help="people's instructions for a robot in coloured rooms (golden.jsonl of Clean-up World)",
    )  # fmt: skip
    option(
        "--own", type=Path, metavar="TSV",
        help="your own sentences: each in double quotes, a tab, and a JSON list of the correct "
        "formulas ([] in the list: a refusal is correct, too); the first line is a heading",
    )  # fmt: skip
    option(
        "--everyday", type=Path, metavar="JSONL",
        help="score only these everyday sentences, with questions and orders to learn among them "
        "(see docs/language.md)",
    )  # fmt: skip
    option(
        "--failures",
        type=Path,
        metavar="FILE",
        help="write the failures to this file, as JSON lines",
    )
    option("--out", type=Path, metavar="FILE", help="write the counts to this file, as JSON")
    translate.set_defaults(handler=lazy_handler("edge.lab.eval.translate", "run", lab=True))


def _rooms(kinds) -> None:  # type: ignore[no-untyped-def]
    rooms = kinds.add_parser(
        "rooms",
        help="compare the rooms of the map with those of ProcTHOR houses, and drive to some",
    )
    rooms.add_argument("config", nargs="?", default="demo", help=f"{CONFIG} (default: demo)")
    option = rooms.add_argument
    option(
        "--worlds", nargs="+", required=True, metavar="WORLDS",
        help="houses whose rooms have kinds: FILE.jsonl.gz[0:75]",
    )  # fmt: skip
    option(
        "--goals", type=int, default=2, metavar="N",
        help="drives in each house, each to a room of another kind (default: %(default)s)",
    )  # fmt: skip
    option(
        "--goals-only", action="store_true", help="do not explore the houses to compare the rooms"
    )
    option("--seed", type=int, default=0, help="seed of the starts (default: %(default)s)")
    rooms.set_defaults(handler=lazy_handler("edge.lab.eval.rooms", "run", lab=True))


def _trajectories(kinds) -> None:  # type: ignore[no-untyped-def]
    trajectories = kinds.add_parser(
        "trajectories", help="evaluate trajectories from instructions (OpenNav IV)"
    )
    option = trajectories.add_argument
    option(
        "places", nargs="*", default=["streets[0:200]"], metavar="PLACES",
        help="streets[0:200] (0 to 99 are for tuning), kitti:FOLDER of a SemanticKITTI sequence, "
        "or house:CONFIG (default: streets[0:200])",
    )  # fmt: skip
    option(
        "--methods", metavar="NAME;NAME;…",
        help="separated by semicolons: ours; ours, not refined; vlt_code; a_star; with --url also "
        "llm_tg (default: all)",
    )  # fmt: skip
    option("--limit", type=count, metavar="N", help="only the first N episodes of each place")
    option(
        "--detector", metavar="CONFIG",
        help="for kitti:FOLDER: find the objects with the detector and segmenter of this "
        "configuration, such as kitti (default: take them from the labels)",
    )  # fmt: skip
    option(
        "--url", help="URL of an OpenAI-compatible server, whose model writes instead of the rules"
    )
    option("--model", help="name of the model on the server")
    option(
        "--rounds", type=count, default=4, metavar="N",
        help="most answers of the model for one episode (default: %(default)s)",
    )  # fmt: skip
    option(
        "--time-limit", type=count, default=120, metavar="S",
        help="time for these answers together, in seconds (default: %(default)s)",
    )  # fmt: skip
    option(
        "--out", type=Path, default=Path("trajectories"), metavar="DIR",
        help="folder for outcomes.jsonl, episodes.jsonl and pictures; results there are not run "
        "again (default: ./%(default)s)",
    )  # fmt: skip
    trajectories.set_defaults(
        handler=lazy_handler("edge.lab.eval.trajectories.run", "run", lab=True)
    )
