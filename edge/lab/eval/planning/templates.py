"""Makes the tasks of `edge eval planning`: English sentences with their formulas (ViTL V-C).

A task is a template, an abstract temporal structure over placeholders, filled with objects of
HM3D's six categories. `FAMILIES` is the distribution of the templates. The paper gives its kinds
("disjunctive branches and until constraints, up to 6 targets") but not their shares, which are
ours. "Do not reach X until Y" is the weak until `!X W Y`: the paper writes U, but its tables II and
III hold only under W.

Tasks that contradict themselves are drawn again, and no two tasks have the same formula.
"""

from __future__ import annotations

import random
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from edge.lab.eval.planning.delexicalised import HM3D_OBJECTS, delexicalise
from edge.mission.logic.ltl import Formula, always, ap, conj, disj, eventually, neg, weak_until

SPOKEN = {"houseplant": "potted plant", "television": "tv", "sofa": "couch"}
"""Canonical name of an object → the paper's word for it, if they differ."""

JOINTS = (", then {}", " and then {}", ", then reach {}")
"""Continuations of a sequence, as in the paper's example, case studies and running example."""

PLACEHOLDERS = len(HM3D_OBJECTS)
"""A placeholder is a number from 0 to here, exclusive: an index into a task's objects."""

Step = tuple[int, ...]
"""One target of a sequence: one placeholder, or several to choose from."""


@dataclass(frozen=True, slots=True)
class BenchmarkTask:
    """A sentence and its formula.

    Attributes:
        family: name of the template's family.
        formula: over the canonical names of objects.
    """

    id: int
    family: str
    sentence: str
    formula: Formula


@dataclass(frozen=True, slots=True)
class Family:
    """A family of similar templates. Pairs are inclusive ranges of a uniform distribution.

    Attributes:
        share: relative frequency among the draws.
        branches: number of alternatives of the task ("…; or reach …").
        length: number of steps of each branch.
        either: probability that a step is a choice of two objects.
        must_choose: at least one step is such a choice.
        any_order: the steps of a branch have no order.
        untils: number of constraints "do not reach X until Y is reached", with different X.
        avoided: number of objects never to be reached.
    """

    name: str
    share: float
    branches: tuple[int, int] = (1, 1)
    length: tuple[int, int] = (2, 4)
    either: float = 0.0
    must_choose: bool = False
    any_order: bool = False
    untils: tuple[int, int] = (0, 0)
    avoided: int = 0


FAMILIES = (
    Family("single", 0.01, length=(1, 1)),
    Family("sequence", 0.12),
    Family("choice", 0.12, length=(1, 4), either=0.5, must_choose=True),
    Family("any-order", 0.08, any_order=True),
    Family("branches", 0.20, branches=(2, 3), either=0.15),
    Family("sequence-until", 0.10, either=0.15, untils=(1, 2)),
    Family("branches-until", 0.27, branches=(2, 3), either=0.15, untils=(1, 3)),
    Family("any-order-until", 0.05, any_order=True, untils=(1, 2)),
    Family("avoid", 0.05, branches=(1, 3), length=(1, 4), either=0.15, untils=(0, 1), avoided=1),
)


@dataclass(frozen=True, slots=True)
class Template:
    """An abstract temporal structure over the placeholders 0 … 5.

    Attributes:
        branches: alternatives, each a sequence of steps (a set with `any_order`).
        any_order: the steps of a branch have no order.
        untils: (X, Y) for "do not reach X until Y is reached".
        avoided: placeholders never to be reached.
        joint: an entry of `JOINTS`.
    """

    branches: tuple[tuple[Step, ...], ...]
    any_order: bool = False
    untils: tuple[tuple[int, int], ...] = ()
    avoided: tuple[int, ...] = ()
    joint: str = JOINTS[0]

    @property
    def placeholders(self) -> frozenset[int]:
        """The placeholders in use."""
        steps = {i for branch in self.branches for step in branch for i in step}
        return frozenset(steps.union(self.avoided, *self.untils))


def generate(n: int = 2000, seed: int = 0) -> list[BenchmarkTask]:
    """Generate the benchmark: `n` satisfiable tasks with different formulas, the same for a seed.

    Example:
        >>> generate(4)[3].sentence
        'Reach a potted plant, then reach a toilet.'
    """
    return different_tasks(draws(random.Random(seed), FAMILIES, HM3D_OBJECTS), n)


Draw = tuple[Family, Template, list[str]]
"""A template with its family, and the objects to fill it."""


def different_tasks(drawn: Iterable[Draw], n: int) -> list[BenchmarkTask]:
    """Return the first `n` satisfiable tasks with different formulas; fewer if there are fewer."""
    tasks: dict[Formula, BenchmarkTask] = {}
    for family, template, objects in drawn:
        if len(tasks) == n:
            break
        formula = formula_of(template, objects)
        if formula not in tasks and is_open_task(formula):
            sentence = sentence_of(template, objects)
            tasks[formula] = BenchmarkTask(len(tasks), family.name, sentence, formula)
    return list(tasks.values())


def formula_of(template: Template, objects: Sequence[str]) -> Formula:
    """Return the formula of a template with its objects, as in ViTL but with the weak until."""

    def step(choices: Step) -> Formula:
        return disj(*[ap(objects[i]) for i in choices])

    def sequence(steps: tuple[Step, ...]) -> Formula:
        first, *rest = steps
        return eventually(conj(step(first), *([sequence(tuple(rest))] if rest else [])))

    def branch(steps: tuple[Step, ...]) -> Formula:
        if template.any_order:
            return conj(*[eventually(step(choices)) for choices in steps])
        return sequence(steps)

    parts = [disj(*[branch(steps) for steps in template.branches])]
    parts += [weak_until(neg(ap(objects[x])), ap(objects[y])) for x, y in template.untils]
    parts += [always(neg(ap(objects[x]))) for x in template.avoided]
    return conj(*parts)


def sentence_of(template: Template, objects: Sequence[str]) -> str:
    """Return the sentence of a template with its objects, in the paper's wording."""

    # "either a bed or a tv and then a couch" is ambiguous: join with a comma.
    choice_inside = any(len(choices) > 1 for steps in template.branches for choices in steps[:-1])
    joint = JOINTS[0] if choice_inside and template.joint == JOINTS[1] else template.joint

    def noun(i: int) -> str:
        word = SPOKEN.get(objects[i], objects[i])
        return f"{'an' if word[0] in 'aeiou' else 'a'} {word}"

    def step(choices: Step) -> str:
        either = "either " if len(choices) > 1 else ""
        return either + " or ".join(map(noun, choices))

    def branch(steps: tuple[Step, ...]) -> str:
        if template.any_order:
            *most, last = map(step, steps)
            return f"{', '.join(most)} and {last} in any order"
        first, *rest = steps
        return step(first) + "".join(joint.format(step(choices)) for choices in rest)

    sentences = ["reach " + "; or reach ".join(map(branch, template.branches))]
    if template.untils:
        constraints = [
            f"do not reach {noun(x)} until {noun(y)} is reached" for x, y in template.untils
        ]
        sentences.append(", and ".join(constraints))
    sentences += [f"never reach {noun(x)}" for x in template.avoided]
    return " ".join(f"{s[0].upper()}{s[1:]}." for s in sentences)


def draws(rng: random.Random, families: Sequence[Family], objects: Sequence[str]) -> Iterator[Draw]:
    """Yield random draws without end.

    If there are fewer `objects` than `PLACEHOLDERS`, some placeholders of a template may have none.
    """
    while True:
        family = _draw_family(families, rng.random())
        yield family, _draw_template(family, rng), _draw_sample(objects, PLACEHOLDERS, rng)


def _draw_family(families: Sequence[Family], u: float) -> Family:
    total = sum(family.share for family in families)
    for family in families:
        u -= family.share / total
        if u < 0:
            return family
    return families[-1]


def _draw_template(family: Family, rng: random.Random) -> Template:
    """Draw a template of the family, filled with placeholders."""
    branches: list[tuple[Step, ...]] = []
    for _ in range(_draw_between(family.branches, rng)):
        branch = _draw_branch(family, rng)
        while branch in branches:
            branch = _draw_branch(family, rng)
        branches.append(branch)
    targets = sorted({i for branch in branches for step in branch for i in step})
    everything = range(PLACEHOLDERS)
    constrained = _draw_sample(targets, _draw_between(family.untils, rng), rng)
    untils = [(x, _draw_sample([y for y in everything if y != x], 1, rng)[0]) for x in constrained]
    return Template(
        tuple(branches),
        family.any_order,
        tuple(untils),
        tuple(_draw_sample(everything, family.avoided, rng)),
        _draw_sample(JOINTS, 1, rng)[0],
    )


def _draw_branch(family: Family, rng: random.Random) -> tuple[Step, ...]:
    """Draw steps with different placeholders."""
    length = _draw_between(family.length, rng)
    free = _draw_sample(range(PLACEHOLDERS), PLACEHOLDERS, rng)
    choices = [rng.random() < family.either for _ in range(length)]
    if family.must_choose and not any(choices):
        choices[int(rng.random() * length)] = True
    steps: list[Step] = []
    for i, choice in enumerate(choices):
        # A choice takes two placeholders; each later step needs at least one.
        can_take_two = len(free) - 2 >= length - i - 1
        steps.append(tuple(free.pop() for _ in range(2 if choice and can_take_two else 1)))
    return tuple(steps)


def is_open_task(formula: Formula) -> bool:
    """Return True if the formula can be satisfied, and is not yet satisfied at the start."""
    return int(delexicalise(formula).automaton.steps_left[0]) > 0


# The draws use random() alone: other methods of `Random` give different numbers in different
# versions of Python.
def _draw_between(limits: tuple[int, int], rng: random.Random) -> int:
    low, high = limits
    return low + int(rng.random() * (high - low + 1))


def _draw_sample(items: Sequence, k: int, rng: random.Random) -> list:  # type: ignore[type-arg]
    """Return `k` different items in random order; all of them if there are fewer."""
    return sorted(items, key=lambda _: rng.random())[:k]
