"""What `edge eval` takes."""

from __future__ import annotations

from pathlib import Path

from edge.cli.options import CONFIG, cores, count, lazy, seed, shares, switched


def add(commands) -> None:  # type: ignore[no-untyped-def]
    """Add `eval` and its kinds."""
    evaluate = commands.add_parser("eval", help="evaluate episodes, planners, translators")
    kinds = evaluate.add_subparsers(title="kinds", required=True, metavar="KIND")
    _episodes(kinds)
    _planning(kinds)
    _translate(kinds)
    _trajectories(kinds)


def _episodes(kinds) -> None:  # type: ignore[no-untyped-def]
    episodes = kinds.add_parser(
        "episodes", help="find-the-object episodes in simulated time: policies side by side"
    )
    episodes.add_argument("config", nargs="?", default="demo", help=f"{CONFIG} (default: demo)")
    option = episodes.add_argument_group("what to do").add_argument
    option(
        "--episodes", type=Path, metavar="FILE",
        help="the episodes of a file that --plan wrote; the other options of this group then say "
        "nothing, but for --limit",
    )  # fmt: skip
    option("--plan", type=Path, metavar="FILE", help="write the episodes there and stop")
    option(
        "--worlds", nargs="+", metavar="WORLDS",
        help="FILE.jsonl.gz[0:75], generated[1000:1050], house:NAME or MESH.glb,OBJECTS.json; "
        "default: the configuration's own",
    )  # fmt: skip
    option(
        "--targets", metavar="NAME,NAME,…",
        help="or `common`, the default with --worlds: sixteen large things that most homes have; "
        "a world that lacks one has no episodes with it",
    )  # fmt: skip
    option("--starts", type=count, default=4, help="a target and world (default: %(default)s)")
    option("--per-world", type=count, metavar="N", help="at most N episodes a world, at random")
    option(
        "--missions", type=count, metavar="N",
        help="instead, N missions a world with two to four of the targets: orders, choices",
    )  # fmt: skip
    option("--limit", type=count, metavar="N", help="the first N episodes only")
    option("--seed", type=int, default=0, help="of starts and choices (default: %(default)s)")
    option(
        "--min-distance", type=float, default=4.0, metavar="M",
        help="of driving from a start to its target (default: %(default)g)",
    )  # fmt: skip
    option = episodes.add_argument_group("what to compare").add_argument
    option(
        "--column", nargs="+", action="append", metavar=("NAME", "KEY=VALUE"),
        help="a name, and what to change in the configuration: "
        "--column near policy.kind=nearest_frontier; may be repeated",
    )  # fmt: skip
    option(
        "--columns", type=Path, metavar="FILE",
        help="columns of a YAML file: name: {policy: {kind: …}}; a `config:` in one names another "
        "configuration to change",
    )  # fmt: skip
    option = episodes.add_argument_group("how").add_argument
    option(
        "--out", type=Path, metavar="DIR",
        help="keep outcomes.jsonl and episodes.jsonl there, and run only what it has not",
    )  # fmt: skip
    option(
        "--report", type=Path, metavar="DIR",
        help="--out, and a report of every episode that is run, with pictures",
    )  # fmt: skip
    option(
        "--workers", "--jobs", type=count, default=1, metavar="N",
        help="processes of one thread each (default: this one only)",
    )  # fmt: skip
    option(
        "--processes", action="store_true",
        help="robot, controller and service as processes over Zenoh",
    )  # fmt: skip
    option = episodes.add_argument_group("what came of it").add_argument
    option(
        "--compare", type=Path, metavar="DIR",
        help="run nothing: tables, plots and every trail on its map, of what --out filled",
    )  # fmt: skip
    option(
        "--baseline", metavar="NAME",
        help="the column that the others are held against (default: the first)",
    )  # fmt: skip
    compare = lazy("edge.lab.eval.comparison.run", "run", lab=True)
    runs = lazy("edge.lab.eval.runs", "run", lab=True)
    of_runs = ("--episodes", "--plan", "--worlds", "--column", "--columns", "--out", "--report")
    switched(episodes, "--compare", compare, ("--baseline",), runs, of_runs)


_P_OBS = "0.1,0.2,0.3,0.4,0.5,0.6,0.7,0.8,0.9,1.0"


def _planning(kinds) -> None:  # type: ignore[no-untyped-def]
    planning = kinds.add_parser(
        "planning", help="mission planners on tasks in language (ViTL figure 4)"
    )
    option = planning.add_argument
    option("--tasks", type=Path, metavar="FILE", help="tasks from there (JSON lines) instead")
    option("--export", type=Path, metavar="FILE", help="write the tasks there and stop")
    option("--n", type=count, default=2000, help="tasks to generate (default: %(default)s)")
    option("--seed", type=seed, default=0, help="of tasks and of luck (default: %(default)s)")
    option(
        "--p-obs", type=shares, default=_P_OBS, metavar="P,P,…",
        help="probabilities that an exploration finds its target (default: 0.1,0.2,…,1.0)",
    )  # fmt: skip
    option("--planners", metavar="NAME,NAME,…", help="default: all that need no language model")
    option("--episodes", type=count, default=1, help="a task and p_obs (default: %(default)s)")
    option("--jobs", type=count, default=cores(), help="processes (default: one a core)")
    option(
        "--out", type=Path, default=Path("planning-report"), metavar="DIR",
        help="for the plots and results.json (default: ./%(default)s)",
    )  # fmt: skip
    option("--llm", metavar="URL", help="compare a language model too: an OpenAI-compatible API")
    option("--model", default="default", help="its name on that server (default: %(default)s)")
    option(
        "--llm-tasks", type=count, default=20, metavar="N",
        help="how many of the tasks it gets (default: %(default)s)",
    )  # fmt: skip
    planning.set_defaults(handler=lazy("edge.lab.eval.planning.run", "run", lab=True))


def _translate(kinds) -> None:  # type: ignore[no-untyped-def]
    translate = kinds.add_parser("translate", help="how well instructions become formulas")
    option = translate.add_argument
    option(
        "--backend", nargs="+", choices=("grammar", "model", "auto", "llm"),
        default=("grammar", "model", "auto"), metavar="NAME",
        help="translators to score: grammar, model, auto, llm (default: all but llm)",
    )  # fmt: skip
    option("--url", help="of the OpenAI-compatible server, for --backend llm")
    option("--model", help="its model, for --backend llm")
    option(
        "--constrain", choices=("gbnf", "guided_grammar", "none"), default="none",
        help="how the server is told the formulas' grammar, for --backend llm",
    )  # fmt: skip
    option("--limit", type=count, metavar="N", help="at most N instructions of each set")
    option("--seed", type=int, default=0, help="of the benchmark's tasks (default: 0)")
    option(
        "--lang2ltl", type=Path, metavar="CSV",
        help="Lang2LTL's symbolic utterances (symbolic_batch12_noperm.csv); without it that set "
        "is skipped",
    )  # fmt: skip
    option(
        "--clean-up", type=Path, metavar="JSONL",
        help="what people wrote for a robot in coloured rooms (golden.jsonl of Clean-up World)",
    )  # fmt: skip
    option(
        "--own", type=Path, metavar="TSV",
        help="sentences of your own: each in double quotes, a tab, and a JSON list of the formulas "
        "that are right ([] among them: refusing is); the first line is a heading",
    )  # fmt: skip
    option("--failures", type=Path, metavar="FILE", help="what failed, as JSON lines")
    option("--out", type=Path, metavar="FILE", help="the counts as JSON")
    translate.set_defaults(handler=lazy("edge.lab.eval.translate", "run", lab=True))


def _trajectories(kinds) -> None:  # type: ignore[no-untyped-def]
    trajectories = kinds.add_parser(
        "trajectories", help="trajectories by language against what was meant (OpenNav IV)"
    )
    option = trajectories.add_argument
    option(
        "places", nargs="*", default=["streets[0:200]"], metavar="PLACES",
        help="streets[0:200] (of these 0-99 are for tuning), kitti:FOLDER of a SemanticKITTI "
        "sequence, house:CONFIG (default: streets[0:200])",
    )  # fmt: skip
    option(
        "--methods", metavar="NAME;NAME;…",
        help="ours; ours, not refined; vlt_code; a_star; with --url llm_tg too (default: all)",
    )  # fmt: skip
    option("--limit", type=count, metavar="N", help="the first N episodes of each place only")
    option(
        "--detector", metavar="CONFIG",
        help="of kitti:FOLDER the scenes are made of image and scan alone, with the detector and "
        "segmenter of a configuration, such as kitti (default: the labels tell what is there)",
    )  # fmt: skip
    option("--url", help="of an OpenAI-compatible server, whose model writes instead of the rules")
    option("--model", help="its model")
    option(
        "--rounds", type=count, default=4, metavar="N",
        help="answers that the model may give an episode (default: %(default)s)",
    )  # fmt: skip
    option(
        "--time-limit", type=count, default=120, metavar="S",
        help="seconds for all of them (default: %(default)s)",
    )  # fmt: skip
    option(
        "--out", type=Path, default=Path("trajectories"), metavar="DIR",
        help="for outcomes.jsonl, episodes.jsonl and pictures; what it has is not run again "
        "(default: ./%(default)s)",
    )  # fmt: skip
    trajectories.set_defaults(handler=lazy("edge.lab.eval.trajectories.run", "run", lab=True))
