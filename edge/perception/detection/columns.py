"""What a detector is asked for beside its prompts, and under which words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edge import names
from edge.perception.embedding.text import TextEncoder, words_for


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """The columns of text that a detector's network compares an image with.

    A thing has one column for each of its names, and scores what the best of them does. Things are
    the prompts, the words of the context, then whatever else may stand in a target's place.

    Attributes:
        words: of each column, for the text encoder.
        thing: (columns,) int32, whose name it is.
        things: how many there are.
        context: canonical names of the things from `len(prompts)` on.
        competes: (2, prompts, things) bool: whether a thing is another than the prompt's, where
            that is wholly in view and where the image cuts it off.
    """

    words: tuple[str, ...]
    thing: np.ndarray
    things: int
    context: tuple[str, ...]
    competes: np.ndarray


def columns_for(prompts: Sequence[str], background: Sequence[str], text: TextEncoder) -> Columns:
    """
    Args:
        background: words that the encoder knows.

    Raises:
        PromptError: see `TextEncoder.resolve`.
    """
    context: dict[str, list[str]] = {}
    around = names.outside(background, prompts)
    for word in background:
        context.setdefault(names.canonical(word), []).append(word)
    # A kind of one prompt's thing may still stand in the place of another's.
    rest = [word for word in background if names.canonical(word) not in around]
    rest += [c for prompt in prompts for c in text.contrasts(prompt)]
    rest = [word for word in dict.fromkeys(rest) if word not in prompts]
    named = [*prompts, *around, *rest]
    competes = competitors(prompts, named, text)
    useful = competes.any(axis=(0, 1))
    useful[: len(prompts) + len(around)] = True
    things = [[prompt, *text.synonyms(prompt)] for prompt in prompts]
    things += [context[name] for name in around]
    things += [[word] for word in rest]
    things = [words for words, kept in zip(things, useful, strict=True) if kept]
    return Columns(
        tuple(word for words in things for word in words),
        np.repeat(np.arange(len(things), dtype=np.int32), [len(words) for words in things]),
        len(things),
        around,
        np.ascontiguousarray(competes[:, :, useful]),
    )


def competitors(prompts: Sequence[str], things: Sequence[str], text: TextEncoder) -> np.ndarray:
    """(2, prompts, things) bool, see `Columns.competes`; the prompts come first among the things.

    What one view does not tell from the prompt's thing (`names.near`) never competes in one image,
    unless it is what the prompt is not (another colour, another size as far as that can be seen);
    who weighs many images may tell them apart.
    """
    known = words_for(things, text.resolve)
    words = [(thing, known.get(thing, thing)) for thing in things]
    competes = np.ones((2, len(prompts), len(things)), np.bool_)
    for row, prompt in enumerate(prompts):
        contrasts = set(text.contrasts(prompt))
        seen_in_part = set(text.contrasts(prompt, whole=False))
        for column, said in enumerate(words):
            contrast = not contrasts.isdisjoint(said)
            unseen = contrast and seen_in_part.isdisjoint(said)
            near = any(names.near(a, b) for a in words[row] for b in said)
            competes[0, row, column] = contrast or not near
            competes[1, row, column] = competes[0, row, column] and not unseen
    return competes
