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


def add_eval(commands) -> None:  # type: ignore[no-untyped-def]
    """Add `eval` and its kinds."""
    evaluate = commands.add_parser(
        "eval", help="measure the quality of policies, planners, translators and trajectories"
    )
    kinds = evaluate.add_subparsers(title="kinds", required=True, metavar="KIND")
    episodes = "compare policies or settings in simulated searches for objects"
    _add_episodes(kinds, "episodes", episodes, "demo")
    textured = "the same in 125 held-out houses with textured furniture: 500 searches"
    _add_episodes(kinds, "textured", textured, "textured", workers=cores(), starts=1)
    _add_planning(kinds)
    _add_translate(kinds)
    _add_trajectories(kinds)
    _add_rooms(kinds)
    _add_words(kinds)


def _add_episodes(  # type: ignore[no-untyped-def]
    kinds, name: str, text: str, config: str, workers: int = 1, starts: int = 4
) -> None:
    episodes = kinds.add_parser(name, help=text)
    episodes.add_argument("config", nargs="?", default=config, help=f"{CONFIG} (default: {config})")
    group = episodes.add_argument_group("episodes to run")
    option, exclusive = group.add_argument, group.add_mutually_exclusive_group().add_argument
    option(
        "--episodes", type=Path, metavar="FILE",
        help="run the episodes of this file, which --plan wrote; the other options of this group "
        "are then ignored, except --limit",
    )  # fmt: skip
    option("--plan", type=Path, metavar="FILE", help="write the episodes to this file; run none")
    option(
        "--worlds", nargs="+", metavar="WORLDS",
        help="worlds to run in: houses 0 to 74 of a ProcTHOR file (FILE.jsonl.gz[0:75]), "
        "generated houses by seed (generated[1000:1050]), both also with textured furniture "
        "(furnished[1000:1050], furnished:FILE.jsonl.gz[0:75]), a built-in house (house:NAME) or "
        "a mesh with its objects (MESH.glb,OBJECTS.json) (default: the configuration's sim.world)",
    )  # fmt: skip
    option(
        "--targets", metavar="NAME,NAME,…",
        help="objects to find; `common` means sixteen large objects of most homes, `vocabulary` "
        "all names of $EDGE_VOCABULARY, and `rooms`, with --goals, the kinds of rooms; a target "
        "that a world lacks is skipped there (default with --worlds: common)",
    )  # fmt: skip
    option(
        "--min-size", type=float, default=0.0, metavar="M",
        help="with --worlds: least size of a target, in m (default: 0)",
    )  # fmt: skip
    option(
        "--starts", type=count, default=starts, help="number of start poses for each target in "
        "each world (default: %(default)s)",
    )  # fmt: skip
    option(
        "--per-world", type=count, metavar="N",
        help="keep at most N episodes of each world, drawn at random (default: all)",
    )  # fmt: skip
    exclusive(
        "--missions", type=count, metavar="N",
        help="run N missions with two to four targets in each world, instead of searches for one "
        "target",
    )  # fmt: skip
    exclusive(
        "--goals", type=count, metavar="N",
        help="run one session in each world, instead of single searches: N targets one after "
        "another, once with and once without memory of the earlier searches",
    )  # fmt: skip
    option(
        "--moved", type=share, default=0.0, metavar="SHARE",
        help="with --goals: share of the movable objects that are moved between two searches, 0 "
        "to 1 (default: 0)",
    )  # fmt: skip
    exclusive(
        "--zones", action="store_true",
        help="put a random keep-out zone on the shortest path of each episode",
    )  # fmt: skip
    exclusive(
        "--ask", action="store_true",
        help="run one episode in each world, instead of searches: the robot explores it, then is "
        "asked where each target is",
    )  # fmt: skip
    option("--limit", type=count, metavar="N", help="run only the first N episodes (default: all)")
    option(
        "--seed", type=int, default=0,
        help="seed of the random starts, missions and zones (default: %(default)s)",
    )  # fmt: skip
    option(
        "--min-distance", type=float, default=4.0, metavar="M",
        help="least driving distance from start to target, in m (default: %(default)g)",
    )  # fmt: skip
    option = episodes.add_argument_group("arms to compare").add_argument
    option(
        "--arm", nargs="+", action="append", metavar=("NAME", "KEY=VALUE"),
        help="variant of the configuration: its name and the keys that it changes, such as --arm "
        "near policy.kind=nearest_frontier; may be repeated (default: only the configuration as "
        "it is)",
    )  # fmt: skip
    option(
        "--arms", type=Path, metavar="FILE",
        help="read arms from a YAML file, one `name: {policy: {kind: …}}` for each; with the key "
        "`config:` an arm starts from another configuration",
    )  # fmt: skip
    option = episodes.add_argument_group("how to run").add_argument
    option(
        "--out", type=Path, metavar="DIR",
        help="folder for outcomes.jsonl and episodes.jsonl; episodes that have an outcome there "
        "are not run again (default: nothing is written)",
    )  # fmt: skip
    option(
        "--report", type=Path, metavar="DIR",
        help="like --out; also write a web page with pictures for each episode to this folder",
    )  # fmt: skip
    option(
        "--workers", "--jobs", type=count, default=workers, metavar="N",
        help="run in N processes of one thread each; 1: in this process (default: %(default)s)",
    )  # fmt: skip
    option(
        "--processes", action="store_true",
        help="run simulator, controller and service as separate processes that talk over Zenoh",
    )  # fmt: skip
    option = episodes.add_argument_group("results").add_argument
    option(
        "--compare", type=Path, metavar="DIR",
        help="run no episode; read the outcomes in this folder, which --out wrote, and write "
        "tables, plots and maps of them there",
    )  # fmt: skip
    option(
        "--baseline", metavar="NAME",
        help="with --compare: name of the arm that the others are compared with (default: the "
        "first)",
    )  # fmt: skip
    compare = lazy_handler("edge.lab.eval.comparison.run", "run", extra="lab")
    runs = lazy_handler("edge.lab.eval.runs", "run" if name == "episodes" else name, extra="lab")
    only_runs = ("--episodes", "--plan", "--worlds", "--arm", "--arms", "--out", "--report")
    dispatch_on_option(
        episodes, "--compare", on=compare, on_only=("--baseline",), off=runs, off_only=only_runs
    )


_P_OBS = "0.1,0.2,0.3,0.4,0.5,0.6,0.7,0.8,0.9,1.0"


def _add_planning(kinds) -> None:  # type: ignore[no-untyped-def]
    planning = kinds.add_parser(
        "planning", help="compare mission planners on simulated missions (figure 4 of ViTL)"
    )
    option = planning.add_argument
    option(
        "--n", type=count, default=2000, help="number of missions to generate (default: "
        "%(default)s)",
    )  # fmt: skip
    option(
        "--seed", type=seed, default=0, help="seed of the missions and of what explorations find "
        "(default: %(default)s)",
    )  # fmt: skip
    option(
        "--p-obs", type=probabilities, default=_P_OBS, metavar="P,P,…",
        help="values to try for the probability that one exploration finds its target (default: "
        "0.1,0.2,…,1.0)",
    )  # fmt: skip
    option(
        "--planners",
        metavar="NAME,NAME,…",
        help="planners to compare (default: all)",
    )
    option(
        "--episodes", type=count, default=1, metavar="N",
        help="number of runs for each mission and probability (default: %(default)s)",
    )  # fmt: skip
    option(
        "--jobs", type=count, default=cores(), help="number of processes (default: one for each "
        "core)",
    )  # fmt: skip
    option(
        "--out", type=Path, default=Path("planning-report"), metavar="DIR",
        help="folder for plots and results.json (default: ./%(default)s)",
    )  # fmt: skip
    planning.set_defaults(handler=lazy_handler("edge.lab.eval.planning.run", "run", extra="lab"))


def _add_translate(kinds) -> None:  # type: ignore[no-untyped-def]
    translate = kinds.add_parser(
        "translate", help="measure how many instructions are translated to the correct formula"
    )
    option = translate.add_argument
    option(
        "--backend", nargs="+", choices=("grammar", "model", "auto", "llm"),
        default=("grammar", "model", "auto"), metavar="NAME",
        help="translators to score: grammar, model, auto, llm (default: all but llm)",
    )  # fmt: skip
    option("--url", help="for --backend llm: URL of the OpenAI-compatible server")
    option("--model", help="for --backend llm: the model's name on the server")
    option(
        "--constrain", choices=("gbnf", "guided_grammar", "none"), default="none",
        help="for --backend llm: request field that makes the server answer in the formulas' "
        "grammar: gbnf (llama.cpp), guided_grammar (vLLM 0.11 or newer), or none: no constraint "
        "(default: none)",
    )  # fmt: skip
    option(
        "--limit", type=count, metavar="N",
        help="score at most N instructions of each set (default: all)",
    )  # fmt: skip
    option("--seed", type=int, default=0, help="seed of the generated instructions (default: 0)")
    option(
        "--lang2ltl", type=Path, metavar="CSV",
        help="also score Lang2LTL's set: its file symbolic_batch12_noperm.csv (default: skipped)",
    )  # fmt: skip
    option(
        "--clean-up", type=Path, metavar="JSONL",
        help="also score Clean-up World's set, people's instructions for a robot in coloured "
        "rooms: its file golden.jsonl (default: skipped)",
    )  # fmt: skip
    option(
        "--own", type=Path, metavar="TSV",
        help="also score your own sentences: after a line of headings, each line has a sentence "
        "in double quotes, a tab, and a JSON list of the correct formulas; [] in the list means "
        "that a refusal is correct, too",
    )  # fmt: skip
    option(
        "--everyday", type=Path, metavar="JSONL",
        help="score only the everyday sentences in this file (format: docs/language.md), which may "
        "also be questions, or things to remember",
    )  # fmt: skip
    option(
        "--failures", type=Path, metavar="FILE", help="write the instructions that were "
        "translated wrongly to this file, as JSON Lines",
    )  # fmt: skip
    option(
        "--out", type=Path, metavar="FILE", help="write the numbers of right and wrong "
        "translations to this file, as JSON",
    )  # fmt: skip
    translate.set_defaults(handler=lazy_handler("edge.lab.eval.translate", "run", extra="lab"))


def _add_rooms(kinds) -> None:  # type: ignore[no-untyped-def]
    rooms = kinds.add_parser(
        "rooms",
        help="explore ProcTHOR houses, compare the rooms found with the true ones, drive to some",
    )
    rooms.add_argument("config", nargs="?", default="demo", help=f"{CONFIG} (default: demo)")
    option = rooms.add_argument
    option(
        "--worlds", nargs="+", required=True, metavar="WORLDS",
        help="ProcTHOR houses by number: FILE.jsonl.gz[0:75] means houses 0 to 74 of the file",
    )  # fmt: skip
    option(
        "--goals", type=int, default=2, metavar="N",
        help="number of drives in each house, each to a room of another kind (default: "
        "%(default)s)",
    )  # fmt: skip
    option(
        "--goals-only", action="store_true", help="only drive to rooms; do not explore and compare"
    )
    option("--seed", type=int, default=0, help="seed of the start poses (default: %(default)s)")
    rooms.set_defaults(handler=lazy_handler("edge.lab.eval.rooms", "run", extra="lab"))


def _add_words(kinds) -> None:  # type: ignore[no-untyped-def]
    words = kinds.add_parser(
        "words", help="measure from which score on a detector's words are right, for confirm_scores"
    )
    words.add_argument(
        "config", nargs="?", default="textured", help=f"{CONFIG} (default: textured)"
    )
    option = words.add_argument
    option(
        "--worlds", nargs="+", required=True, metavar="WORLDS",
        help="worlds as of `edge eval episodes`, such as furnished[100:150]",
    )  # fmt: skip
    option("--poses", type=count, default=40, help="images of each world (default: %(default)s)")
    option(
        "--precision", type=share, default=0.9, metavar="SHARE",
        help="wanted share of right objects, 0 to 1 (default: %(default)s)",
    )  # fmt: skip
    option("--seed", type=seed, default=0, help="seed of the poses (default: %(default)s)")
    words.set_defaults(handler=lazy_handler("edge.lab.eval.word_scores", "run", extra="lab"))


def _add_trajectories(kinds) -> None:  # type: ignore[no-untyped-def]
    trajectories = kinds.add_parser(
        "trajectories", help="measure trajectories made from instructions (section IV of OpenNav)"
    )
    option = trajectories.add_argument
    option(
        "places", nargs="*", default=["streets[0:200]"], metavar="PLACES",
        help="built-in streets by number (streets[100:200] means 100 to 199; 0 to 99 were used "
        "for tuning), kitti:FOLDER of a SemanticKITTI sequence, or house:CONFIG, a configuration "
        "with a simulated house (default: streets[0:200])",
    )  # fmt: skip
    option(
        "--methods", metavar="NAME;NAME;…",
        help="methods to compare, with semicolons between: 'ours; ours, not refined; vlt_code; "
        "a_star', with --url also llm_tg (default: all)",
    )  # fmt: skip
    option(
        "--limit", type=count, metavar="N", help="run only the first N episodes of each place "
        "(default: all)",
    )  # fmt: skip
    option(
        "--detector", metavar="CONFIG",
        help="for kitti:FOLDER: find the objects with the detector and segmenter of this "
        "configuration, such as kitti (default: take the objects from the labels)",
    )  # fmt: skip
    option(
        "--url", help="let the model of the OpenAI-compatible server at this URL write the "
        "trajectories (default: built-in rules write them)"
    )  # fmt: skip
    option("--model", help="with --url: the model's name on the server")
    option(
        "--rounds", type=count, default=4, metavar="N",
        help="with --url: maximum number of answers by the model for one episode (default: "
        "%(default)s)",
    )  # fmt: skip
    option(
        "--time-limit", type=count, default=120, metavar="S",
        help="with --url: longest time for all answers of one episode, in s (default: %(default)s)",
    )  # fmt: skip
    option(
        "--out", type=Path, default=Path("trajectories"), metavar="DIR",
        help="folder for outcomes.jsonl, episodes.jsonl and pictures; episodes that have an "
        "outcome there are not run again (default: ./%(default)s)",
    )  # fmt: skip
    trajectories.set_defaults(
        handler=lazy_handler("edge.lab.eval.trajectories.run", "run", extra="lab")
    )
