"""From an instruction and a scene to a coarse trajectory that may be driven (OpenNav III-A3)."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from edge.chat import CutOffError, client_of
from edge.config import Tasks, TrajectoryLimits, WriterModel
from edge.errors import UserError
from edge.tasks import rules
from edge.tasks.functions import Functions
from edge.tasks.ground import Ground, ground_of
from edge.tasks.prompt import MOST_INSTRUCTION_CHARS, messages, version
from edge.tasks.reading import Step
from edge.tasks.scene import Scene
from edge.tasks.script import ScriptLimits, run
from edge.tasks.trajectory import Coarse
from edge.text import one_line

_BLOCK = re.compile(r"```[ \t]*(\w*)[ \t]*\n(.*?)(?:^[ \t]*```|\Z)", re.DOTALL | re.MULTILINE)
_LANGUAGES = ("", "py", "python", "python3")
_THOUGHTS = re.compile(r"\A\s*<think>.*?</think>", re.DOTALL)
_REFUSED = re.compile(r"^\W*REFUSED\b\W*(.*)", re.MULTILINE)
_KEPT_CHARS = 20_000  # of a wrong answer, in the conversation
NO_CODE = "the answer has no ```python block"
NO_TRAJECTORY = "the script called no give_trajectory"


@dataclass(frozen=True, slots=True)
class Round:
    """One answer of the model, and what came of it.

    Attributes:
        answer: all that it said; `code`: the script in it, "" without one.
        error: one line; "" where it gave a trajectory.
    """

    answer: str
    code: str
    printed: str
    error: str


@dataclass(frozen=True, slots=True, eq=False)
class Written:
    """A trajectory and how it came about.

    Attributes:
        understood: what the rules read, in words; "" of a model.
        rounds: of a model; the last one gave the trajectory.
        prompt: version of the model's prompt; "" of the rules.
        ground: what the trajectory was checked on.
        stops_at: number of the thing that the rules read it to end at, wherever one gets nearest;
            None: it ends elsewhere, or a model wrote it.
        stops: for each step of the rules the numbers of the things that the robot stops at;
            empty of a model.
    """

    instruction: str
    coarse: Coarse
    ground: Ground
    understood: str = ""
    rounds: tuple[Round, ...] = ()
    prompt: str = ""
    stops_at: int | None = None
    stops: tuple[tuple[int, ...], ...] = ()


class WriteError(UserError):
    """No trajectory was written; the message says why.

    Attributes:
        rounds: what the model said.
    """

    def __init__(self, message: str, rounds: tuple[Round, ...] = ()) -> None:
        super().__init__(message)
        self.rounds = rounds


def write(
    instruction: str,
    scene: Scene,
    config: Tasks,
    told: Callable[[Round], None] = lambda round: None,
    why: str = "",
    make: Callable[[Ground, TrajectoryLimits], Functions] = Functions,
    which: slice = slice(None),
) -> Written:
    """The trajectory that an instruction asks for, checked, by the writer that is configured.

    Args:
        told: each round of a model as it ends, for who watches.
        why: another one is needed than was written before, for a model.
        make: what the writer may call; evaluations take some of it away.
        which: of the instruction's steps, for the rules; a model does it whole.

    Raises:
        UserError: there is none: `TranslationError` (the rules name the part), `WriteError`,
            `TrajectoryError`, `ChatError` (the server), `UnavailableError` (the interpreter).
    """
    check_instruction(instruction)
    ground = ground_of(scene, config.trajectory.clearance_m)
    if not ground.reachable.any():
        raise WriteError("nothing around the robot is known to be free; drive it to open ground")
    functions = make(ground, config.trajectory)
    if isinstance(config.planner, WriterModel):
        rounds = _ask(instruction, functions, config.planner, told, why)
        assert functions.given is not None
        return Written(instruction, functions.given, ground, "", rounds, version())
    steps = rules.carry_out(instruction, functions, which)
    assert functions.given is not None
    understood = "; ".join(map(str, steps))
    stops_at = steps[-1].things[0].id if steps[-1].kind == "to" else None
    stops = [_stops(step) for step in steps]
    if which.stop is None:  # at the end of all steps the robot stops
        stops[-1] = tuple(thing.id for thing in steps[-1].things)
    return Written(
        instruction, functions.given, ground, understood, stops_at=stops_at, stops=tuple(stops)
    )


def _stops(step: Step) -> tuple[int, ...]:
    """The numbers of the things that the robot stops at with a step."""
    stops = step.kind in ("to", "beside", "between")
    return tuple(thing.id for thing in step.things) if stops else ()


def check_instruction(instruction: str) -> None:
    """See that there is an instruction, of a length that is taken.

    Raises:
        WriteError: there is none.
    """
    if not instruction.strip():
        raise WriteError("the instruction is empty; say where to go")
    if len(instruction) > MOST_INSTRUCTION_CHARS:
        raise WriteError(
            f"the instruction has {len(instruction)} characters, at most {MOST_INSTRUCTION_CHARS} "
            "are taken"
        )


def _ask(
    instruction: str,
    functions: Functions,
    config: WriterModel,
    told: Callable[[Round], None],
    why: str,
) -> tuple[Round, ...]:
    """Algorithm 1 of OpenNav: scripts are run and errors go back until one gives a trajectory."""
    client, begin_s = client_of(config), time.monotonic()
    talk = messages(instruction, functions.ground.scene, functions.limits, config.picture, why)
    rounds: list[Round] = []
    while len(rounds) < config.rounds:
        left_s = config.time_limit_s - (time.monotonic() - begin_s)
        try:
            answer, cut = client.ask(talk, left_s=left_s, temperature=0), ""
        except CutOffError as error:
            answer, cut = error.answer, "the answer was cut off; write a shorter one"
        rounds.append(_round(answer, cut, functions))
        told(rounds[-1])
        if not rounds[-1].error:
            return tuple(rounds)
        if why := _REFUSED.search(_THOUGHTS.sub("", answer)) if not rounds[-1].code else None:
            said = one_line(why[1]) or "it gave no reason"
            raise WriteError(f"{client.url}: the model refused: {said}", tuple(rounds))
        talk += _repair(rounds[-1])
    raise WriteError(
        f"{client.url}: no trajectory in {len(rounds)} answers, the last time: "
        f"{rounds[-1].error}; say it in other words, or use a larger model",
        tuple(rounds),
    )


def _round(answer: str, cut: str, functions: Functions) -> Round:
    """Run what an answer holds. A trajectory counts where its script ran to the end."""
    code = script_in(answer)
    if cut or not code:
        return Round(answer, code, "", cut or NO_CODE)
    functions.given = None
    outcome = run(code, functions, ScriptLimits())
    error = outcome.error or ("" if functions.given is not None else NO_TRAJECTORY)
    return Round(answer, code, outcome.printed, error)


def script_in(answer: str) -> str:
    """The script in an answer: its last block of code.

    >>> script_in("Straight on.\\n```python\\nprint(1)\\n```\\nDone.")
    'print(1)'
    """
    blocks = _BLOCK.findall(_THOUGHTS.sub("", answer))
    scripts = [code for language, code in blocks if language.lower() in _LANGUAGES]
    return scripts[-1].strip() if scripts else ""


def _repair(last: Round) -> list[dict[str, Any]]:
    """The messages that send an error back, and what was printed."""
    printed = f"It printed:\n{last.printed.strip()}\n" if last.printed else ""
    wanted = f"{printed}No trajectory yet: {last.error}. Write the whole corrected script."
    return [
        {"role": "assistant", "content": last.answer[:_KEPT_CHARS] or "..."},
        {"role": "user", "content": wanted},
    ]
