"""The parser of `edge eval`: its kinds and their arguments."""

from __future__ import annotations

from pathlib import Path

from edge.cli.options import (
    config_argument,
    cores,
    count,
    dispatch_on_option,
    flag,
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


# fmt: off
def _add_episodes(  # type: ignore[no-untyped-def]
    kinds, name: str, text: str, config: str, workers: int = 1, starts: int = 4
) -> None:
    episodes = kinds.add_parser(name, help=text)
    config_argument(episodes, config)
    group = episodes.add_argument_group("episodes to run")
    kind, option = group.add_mutually_exclusive_group(), group.add_argument
    option("--episodes", type=Path, metavar="FILE", help="run the episodes of this file, which "
           "--plan wrote; the other options of this group are then ignored, except --limit")
    option("--plan", type=Path, metavar="FILE", help="write the episodes to this file; run none")
    option("--worlds", nargs="+", metavar="WORLDS", help="worlds to run in: houses 0 to 74 of a "
           "ProcTHOR file (FILE.jsonl.gz[0:75]), generated houses by seed (generated[1000:1050]), "
           "both also with textured furniture (furnished[1000:1050], "
           "furnished:FILE.jsonl.gz[0:75]), a built-in house (house:NAME) or a mesh with its "
           "objects (MESH.glb,OBJECTS.json) (default: the configuration's sim.world)")
    option("--targets", metavar="NAME,NAME,…", help="objects to find; `common` means sixteen large "
           "objects of most homes, `vocabulary` all names of $EDGE_VOCABULARY, and `rooms` "
           "the kinds of rooms; a target that a world lacks is skipped there (default "
           "with --worlds: common)")
    option("--min-size", type=float, default=0, metavar="M",
           help="least size of a target, in m")
    option("--starts", type=count, default=starts,
           help="number of start poses for each target in each world")
    option("--per-world", type=count, metavar="N",
           help="keep at most N episodes of each world, drawn at random (default: all)")
    kind.add_argument("--missions", type=count, metavar="N", help="run N missions with two to four "
                      "targets in each world, instead of searches for one target")
    kind.add_argument("--goals", type=count, metavar="N", help="run one session in each world, "
                      "instead of single searches: N targets one after another, once with and once "
                      "without memory of the earlier searches")
    option("--moved", type=share, default=0, metavar="SHARE", help="with --goals: share of the "
           "movable objects that are moved between two searches, 0 to 1")
    flag(kind, "--zones", "put a random keep-out zone on the shortest path of each episode")
    flag(kind, "--ask", "run one episode in each world, instead of searches: the robot explores "
         "it, then is asked where each target is")
    option("--limit", type=count, metavar="N", help="run only the first N episodes (default: all)")
    option("--seed", type=int, default=0, help="seed of the random starts, missions and zones")
    option("--min-distance", type=float, default=4, metavar="M",
           help="least driving distance from start to target, in m")
    option = episodes.add_argument_group("arms to compare").add_argument
    option("--arm", nargs="+", action="append", metavar=("NAME", "KEY=VALUE"), help="variant of "
           "the configuration: its name and the keys that it changes, such as --arm near "
           "policy.kind=nearest_frontier; may be repeated (default: only the configuration as it "
           "is)")
    option("--arms", type=Path, metavar="FILE", help="read arms from a YAML file, one `name: "
           "{policy: {kind: …}}` for each; with the key `config:` an arm starts from another "
           "configuration")
    group = episodes.add_argument_group("how to run")
    option = group.add_argument
    option("--out", type=Path, metavar="DIR", help="folder for outcomes.jsonl and episodes.jsonl; "
           "episodes that have an outcome there are not run again (default: nothing is written)")
    option("--report", type=Path, metavar="DIR", help="like --out; also write a web page with "
           "pictures for each episode to this folder")
    option("--workers", type=count, default=workers, metavar="N",
           help="run in N processes of one thread each; 1: in this process")
    option = episodes.add_argument_group("results").add_argument
    option("--compare", type=Path, metavar="DIR", help="run no episode; read the outcomes in this "
           "folder, which --out wrote, and write tables and maps of them there")
    option("--baseline", metavar="NAME", help="with --compare: name of the arm that the others are "
           "compared with (default: the first)")
    dispatch_on_option(
        episodes, "--compare", on=lazy_handler("edge.lab.eval.comparison.run", extra="lab"),
        on_only=("--baseline",),
        off=lazy_handler("edge.lab.eval.runs", "run" if name == "episodes" else name, "lab"),
        off_only=("--episodes", "--plan", "--worlds", "--arm", "--arms", "--out", "--report"),
    )


def _add_planning(kinds) -> None:  # type: ignore[no-untyped-def]
    planning = kinds.add_parser(
        "planning", help="compare mission planners on simulated missions (figure 4 of ViTL)"
    )
    option = planning.add_argument
    option("--n", type=count, default=2000, help="number of missions to generate")
    option("--seed", type=seed, default=0, help="seed of the missions and of what explorations "
           "find")
    option("--p-obs", type=probabilities, default="0.1,0.2,0.3,0.4,0.5,0.6,0.7,0.8,0.9,1.0",
           metavar="P,P,…", help="values to try for the probability that one exploration finds its "
           "target (default: 0.1,0.2,…,1.0)")
    option("--planners", metavar="NAME,NAME,…", help="planners to compare (default: all)")
    option("--episodes", type=count, default=1, metavar="N",
           help="number of runs for each mission and probability")
    option("--workers", type=count, default=cores(),
           help="number of processes (default: one for each core)")
    option("--out", type=Path, default=Path("planning-report"), metavar="DIR",
           help="folder for results.json (default: ./%(default)s)")
    planning.set_defaults(handler=lazy_handler("edge.lab.eval.planning.run", extra="lab"))


def _add_translate(kinds) -> None:  # type: ignore[no-untyped-def]
    translate = kinds.add_parser(
        "translate", help="measure how many instructions are translated to the correct formula"
    )
    option = translate.add_argument
    option("--backend", nargs="+", choices=("grammar", "model", "auto", "llm"),
           default=("grammar", "model", "auto"), metavar="NAME",
           help="translators to score: grammar, model, auto, llm (default: all but llm)")
    option("--url", help="for --backend llm: URL of the OpenAI-compatible server")
    option("--model", help="for --backend llm: the model's name on the server")
    option("--constrain", choices=("gbnf", "guided_grammar", "none"), default="none",
           help="for --backend llm: request field that makes the server answer in the formulas' "
           "grammar: gbnf (llama.cpp), guided_grammar (vLLM 0.11 or newer), or none: no constraint")
    option("--limit", type=count, metavar="N",
           help="score at most N instructions of each set (default: all)")
    option("--seed", type=int, default=0, help="seed of the generated instructions")
    option("--lang2ltl", type=Path, metavar="CSV", help="also score Lang2LTL's set: its file "
           "symbolic_batch12_noperm.csv (default: skipped)")
    option("--clean-up", type=Path, metavar="JSONL", help="also score Clean-up World's set, "
           "people's instructions for a robot in coloured rooms: its file golden.jsonl (default: "
           "skipped)")
    option("--own", type=Path, metavar="TSV", help="also score your own sentences: after a line of "
           "headings, each line has a sentence in double quotes, a tab, and a JSON list of the "
           "correct formulas; [] in the list means that a refusal is correct, too")
    option("--everyday", type=Path, metavar="JSONL", help="score only the everyday sentences in "
           "this file (format: docs/language.md), which may also be questions, or facts to "
           "remember")
    option("--failures", type=Path, metavar="FILE", help="write the instructions that were "
           "translated wrongly to this file, as JSON Lines")
    option("--out", type=Path, metavar="FILE", help="write the numbers of right and wrong "
           "translations to this file, as JSON")
    translate.set_defaults(handler=lazy_handler("edge.lab.eval.translate", extra="lab"))


def _add_rooms(kinds) -> None:  # type: ignore[no-untyped-def]
    rooms = kinds.add_parser(
        "rooms",
        help="explore ProcTHOR houses, and compare the rooms found with the true ones",
    )
    config_argument(rooms, "demo")
    option = rooms.add_argument
    option("--worlds", nargs="+", required=True, metavar="WORLDS",
           help="ProcTHOR houses by number: FILE.jsonl.gz[0:75] means houses 0 to 74 of the file")
    rooms.set_defaults(handler=lazy_handler("edge.lab.eval.rooms", extra="lab"))


def _add_words(kinds) -> None:  # type: ignore[no-untyped-def]
    words = kinds.add_parser(
        "words", help="measure from which score on a detector's words are right, for confirm_scores"
    )
    config_argument(words, "textured")
    option = words.add_argument
    option("--worlds", nargs="+", required=True, metavar="WORLDS",
           help="worlds as of `edge eval episodes`, such as furnished[100:150]")
    option("--poses", type=count, default=40, help="images of each world")
    option("--precision", type=share, default=0.9, metavar="SHARE",
           help="wanted share of right objects, 0 to 1")
    option("--seed", type=seed, default=0, help="seed of the poses")
    words.set_defaults(handler=lazy_handler("edge.lab.eval.word_scores", extra="lab"))


def _add_trajectories(kinds) -> None:  # type: ignore[no-untyped-def]
    trajectories = kinds.add_parser(
        "trajectories", help="measure trajectories made from instructions (section IV of OpenNav)"
    )
    option = trajectories.add_argument
    option("places", nargs="*", default=["streets[0:200]"], metavar="PLACES",
           help="built-in streets by number (streets[100:200] means 100 to 199; 0 to 99 were used "
           "for tuning), kitti:FOLDER of a SemanticKITTI sequence, or house:CONFIG, a "
           "configuration with a simulated house (default: streets[0:200])")
    option("--methods", metavar="NAME;NAME;…", help="methods to compare, with semicolons between: "
           "'ours; ours, not refined; vlt_code; a_star', with --url also llm_tg (default: all)")
    option("--limit", type=count, metavar="N",
           help="run only the first N episodes of each place (default: all)")
    option("--detector", metavar="CONFIG", help="for kitti:FOLDER: find the objects with the "
           "detector and segmenter of this configuration, such as kitti (default: take the objects "
           "from the labels)")
    option("--url", help="let the model of the OpenAI-compatible server at this URL write the "
           "trajectories (default: built-in rules write them)")
    option("--model", help="with --url: the model's name on the server")
    option("--rounds", type=count, default=4, metavar="N",
           help="with --url: maximum number of answers by the model for one episode")
    option("--time-limit", type=count, default=120, metavar="S",
           help="with --url: longest time for all answers of one episode, in s")
    option("--out", type=Path, default=Path("trajectories"), metavar="DIR", help="folder for "
           "outcomes.jsonl, episodes.jsonl and pictures; episodes that have an outcome there are "
           "not run again (default: ./%(default)s)")
    trajectories.set_defaults(handler=lazy_handler("edge.lab.eval.trajectories.run", extra="lab"))
# fmt: on
