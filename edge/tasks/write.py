"""Writing of a coarse trajectory for an instruction, by rules or by a model (OpenNav III-A3)."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain
from typing import Any

from edge.chat import TokenLimitError, make_chat_client
from edge.config import TasksConfig, TrajectoryLimits, WriterModel
from edge.errors import UserError
from edge.tasks import rules
from edge.tasks.functions import ScriptFunctions
from edge.tasks.prompt import MOST_INSTRUCTION_CHARS, messages, with_new_objects
from edge.tasks.scene.ground import ReachableGround, ground_of
from edge.tasks.scene.scene import Scene
from edge.tasks.script import ScriptLimits, run_script
from edge.tasks.sentences.steps import InstructionStep, describe_steps
from edge.tasks.trajectory import CoarseTrajectory
from edge.text import one_line

# Parts of a model's answer. A block of code: "```python\nprint(1)\n```" gives its language and its
# code. The end of the answer also ends a block.
_BLOCK = re.compile(r"```[ \t]*(\w*)[ \t]*\n(.*?)(?:^[ \t]*```|\Z)", re.DOTALL | re.MULTILINE)
_LANGUAGES = ("", "py", "python", "python3")
# Reasoning at the begin of an answer: "<think>The van is …</think>".
_THOUGHTS = re.compile(r"\A\s*<think>.*?</think>", re.DOTALL)
# A refusal in the form that `prompt.txt` asks for: "REFUSED: there is no van" gives the reason.
_REFUSED = re.compile(r"^\W*REFUSED\b\W*(.*)", re.MULTILINE)
_MAX_ANSWER_CHARS = 20_000  # of a wrong answer in the next request
# Errors of an answer, also sent to the model.
NO_CODE = "the answer has no ```python block"
NO_TRAJECTORY = "the script called no give_trajectory"


@dataclass(frozen=True, slots=True)
class PlanAttempt:
    """One answer of the model and its result.

    Attributes:
        code: the script in the answer; "" if there is none.
        printed: output of the script.
        error: one line; "" if the script gave a trajectory.
    """

    answer: str
    code: str
    printed: str
    error: str


@dataclass(frozen=True, slots=True, eq=False)
class WrittenTrajectory:
    """A trajectory and how it was written.

    Attributes:
        reachable: the ground on which the trajectory was checked.
        understood: interpretation by the rules, in words; "" for a model.
        rounds: answers of a model, oldest first; the last one gave the trajectory.
        stops_at: id of the object at which the entire trajectory ends, as near as the robot gets;
            None if it ends elsewhere or a model wrote it.
        stops: for each step, the ids of the objects that the robot stops at in this step; () for a
            step without a stop. Empty if a model wrote the trajectory.
    """

    coarse: CoarseTrajectory
    reachable: ReachableGround
    understood: str = ""
    rounds: tuple[PlanAttempt, ...] = ()
    stops_at: int | None = None
    stops: tuple[tuple[int, ...], ...] = ()


class WriteError(UserError):
    """No trajectory was written; the message gives the reason.

    Attributes:
        rounds: answers of the model, oldest first.
    """

    def __init__(self, message: str, rounds: tuple[PlanAttempt, ...] = ()) -> None:
        super().__init__(message)
        self.rounds = rounds


def write_trajectory(
    instruction: str,
    scene: Scene,
    config: TasksConfig,
    on_answer: Callable[[PlanAttempt], None] = lambda round: None,
    why: str = "",
    make_functions: Callable[
        [ReachableGround, TrajectoryLimits], ScriptFunctions
    ] = ScriptFunctions,
    step_slice: slice = slice(None),
) -> WrittenTrajectory:
    """Write and check the trajectory for an instruction, with the configured planner.

    Args:
        instruction: the task in words.
        scene: what is around the robot.
        config: the settings of tasks.
        on_answer: called with each answer of a model as soon as it is there, for display.
        why: reason why the previous trajectory has to be replaced, sent to the model; "" for the
            first.
        make_functions: makes the functions that a script may call; evaluations pass a reduced set.
        step_slice: steps of the instruction to do, for the rules only; a model does the entire
            instruction.

    Raises:
        UserError: there is no trajectory: `TranslationError` (the rules name the part),
            `WriteError`, `TrajectoryError`, `ChatError` (the server), `UnavailableError` (the
            interpreter).

    Example:
        >>> import numpy as np
        >>> from edge.geometry import SE2, Grid
        >>> from edge.tasks.scene.scene import Region
        >>> free, floor = np.zeros((100, 100), np.int8), np.ones((100, 100), np.uint8)
        >>> occupancy, regions = (Grid(cells, (-5.0, -5.0), 0.1) for cells in (free, floor))
        >>> pose, hall = SE2(0.0, 0.0, 0.0), {1: Region(1, "floor", 100.0)}
        >>> scene = Scene(0, pose, {}, hall, occupancy, regions, None, None, None, {})
        >>> written = write_trajectory("go straight for 3 metres", scene, TasksConfig())
        >>> written.coarse.points_m[-1].tolist()
        [3.0, 0.0]
    """
    check_instruction(instruction)
    ground = ground_of(scene, config.trajectory.clearance_m)
    if not ground.reachable.any():
        raise WriteError("no free ground is known around the robot; drive the robot to open ground")
    functions = make_functions(ground, config.trajectory)
    if isinstance(config.planner, WriterModel):
        rounds = _ask_model(instruction, functions, config.planner, on_answer, why)
        assert functions.trajectory is not None
        return WrittenTrajectory(functions.trajectory, functions.ground, "", rounds)
    steps = rules.plan_by_rules(instruction, functions, step_slice)
    assert functions.trajectory is not None
    understood = describe_steps(steps)
    stops_at = steps[-1].objects[0].id if _ends_close(steps[-1]) else None
    stops = [_stop_ids(step) for step in steps]
    if step_slice.stop is None:  # the robot stops after the last step of the instruction
        stops[-1] = tuple(obj.id for obj in steps[-1].objects)
    return WrittenTrajectory(
        functions.trajectory, functions.ground, understood,
        stops_at=stops_at, stops=tuple(stops),
    )  # fmt: skip


def _ends_close(step: InstructionStep) -> bool:
    """Return True if a step ends as near to its object as the robot gets."""
    return step.kind == "to" and not step.distance_m


def _stop_ids(step: InstructionStep) -> tuple[int, ...]:
    """Return the ids of the objects that the robot stops at in a step."""
    stops = step.kind in ("to", "next to", "between")
    return tuple(obj.id for obj in step.objects) if stops else ()


def check_instruction(instruction: str) -> None:
    """Check that an instruction is not empty and not too long.

    Raises:
        WriteError: it is.
    """
    if not instruction.strip():
        raise WriteError("the instruction is empty; say where to go")
    if len(instruction) > MOST_INSTRUCTION_CHARS:
        raise WriteError(
            f"the instruction has {len(instruction)} characters, the limit is "
            f"{MOST_INSTRUCTION_CHARS}; shorten it"
        )


def _ask_model(
    instruction: str,
    functions: ScriptFunctions,
    config: WriterModel,
    on_answer: Callable[[PlanAttempt], None],
    why: str,
) -> tuple[PlanAttempt, ...]:
    """Ask the model until a script gives a trajectory; send errors back (OpenNav algorithm 1)."""
    client, begin_s = make_chat_client(config), time.monotonic()
    conversation = messages(
        instruction, functions.ground.scene, functions.limits, config.picture, why
    )
    rounds: list[PlanAttempt] = []
    while len(rounds) < config.max_attempts:
        known = set(functions.detected)
        left_s = config.time_limit_s - (time.monotonic() - begin_s)
        try:
            answer, cut_error = client.ask(conversation, left_s=left_s, temperature=0), ""
        except TokenLimitError as error:
            answer, cut_error = error.answer, "the answer was cut off; write a shorter one"
        rounds.append(_run_answer(answer, cut_error, functions))
        on_answer(rounds[-1])
        if not rounds[-1].error:
            return tuple(rounds)
        refused = _REFUSED.search(_THOUGHTS.sub("", answer))
        if refused and not rounds[-1].code:
            reason = one_line(refused[1]) or "no reason given"
            raise WriteError(f"{client.url}: the model refused: {reason}", tuple(rounds))
        new = [functions.detected[name] for name in functions.detected.keys() - known]
        conversation += _messages_about(rounds[-1])
        if any(new):
            scene = functions.ground.scene
            conversation[-1]["content"] = with_new_objects(
                conversation[-1]["content"], scene, sorted(chain(*new)), config.picture
            )
    raise WriteError(
        f"{client.url}: no trajectory in {len(rounds)} answers, last error: "
        f"{rounds[-1].error}; rephrase the instruction or use a larger model",
        tuple(rounds),
    )


def _run_answer(answer: str, cut_error: str, functions: ScriptFunctions) -> PlanAttempt:
    """Run the script in an answer. Its trajectory counts only if the script runs to its end.

    `cut_error` is the error of an answer that was cut off; "" for an entire answer.
    """
    code = script_in(answer)
    if cut_error or not code:
        return PlanAttempt(answer, code, "", cut_error or NO_CODE)
    functions.trajectory = None
    outcome = run_script(code, functions, ScriptLimits())
    error = outcome.error or ("" if functions.trajectory is not None else NO_TRAJECTORY)
    return PlanAttempt(answer, code, outcome.printed, error)


def script_in(answer: str) -> str:
    """Return the script in an answer: its last block of Python code, or "".

    >>> script_in("Straight on.\\n```python\\nprint(1)\\n```\\nDone.")
    'print(1)'
    """
    blocks = _BLOCK.findall(_THOUGHTS.sub("", answer))
    scripts = [code for language, code in blocks if language.lower() in _LANGUAGES]
    return scripts[-1].strip() if scripts else ""


def _messages_about(last: PlanAttempt) -> list[dict[str, Any]]:
    """Return the messages that send the error of an answer and its output back to the model."""
    printed = f"It printed:\n{last.printed.strip()}\n" if last.printed else ""
    request = f"{printed}No trajectory yet: {last.error}. Write the whole corrected script."
    return [
        {"role": "assistant", "content": last.answer[:_MAX_ANSWER_CHARS] or "..."},
        {"role": "user", "content": request},
    ]
