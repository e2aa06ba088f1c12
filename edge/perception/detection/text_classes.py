"""Text classes of a detector: the prompts, the context words, and competing words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edge import names
from edge.perception.embedding.text import TextEncoder, words_for


@dataclass(frozen=True, slots=True, eq=False)
class TextClasses:
    """The text embeddings that a detector's network compares an image with.

    A thing (class) has one column (text) for each of its names. The score of a thing is the best
    score of its columns. Things are the prompts, then the context words, then other words that
    compete with a prompt.

    Attributes:
        words: text of each column, for the text encoder.
        class_of_text: (columns,) int32, index of each column's thing, ascending.
        n_classes: number of things.
        context: canonical names of the things from `len(prompts)` on.
        competes: (2, prompts, things) bool, True if a thing is another object than the prompt
            names. Row 0 is for an object wholly in view, row 1 for an object that the image border
            cuts off.
    """

    words: tuple[str, ...]
    class_of_text: np.ndarray
    n_classes: int
    context: tuple[str, ...]
    competes: np.ndarray


def text_classes_for(
    prompts: Sequence[str], background: Sequence[str], text: TextEncoder
) -> TextClasses:
    """Collect the text classes of prompts.

    Args:
        prompts: names of the objects to look for.
        background: further words, all known to the encoder.
        text: the detector's text encoder.

    Raises:
        PromptError: see `TextEncoder.resolve`.
    """
    context: dict[str, list[str]] = {}
    around = names.non_targets(background, prompts)
    for word in background:
        context.setdefault(names.canonical(word), []).append(word)
    # A kind of one prompt's thing may still compete with another prompt.
    rest = [word for word in background if names.canonical(word) not in around]
    rest += [c for prompt in prompts for c in text.contrasts(prompt)]
    rest = [word for word in dict.fromkeys(rest) if word not in prompts]
    named = [*prompts, *around, *rest]
    competes = competing_classes(prompts, named, text)
    useful = competes.any(axis=(0, 1))
    useful[: len(prompts) + len(around)] = True
    things = [[prompt, *text.synonyms(prompt)] for prompt in prompts]
    things += [context[name] for name in around]
    things += [[word] for word in rest]
    things = [words for words, kept in zip(things, useful, strict=True) if kept]
    return TextClasses(
        tuple(word for words in things for word in words),
        np.repeat(np.arange(len(things), dtype=np.int32), [len(words) for words in things]),
        len(things),
        around,
        np.ascontiguousarray(competes[:, :, useful]),
    )


def competing_classes(
    prompts: Sequence[str], things: Sequence[str], text: TextEncoder
) -> np.ndarray:
    """Return which things compete with which prompt; see `TextClasses.competes`.

    Two things that look almost alike in one view (`names.look_alike`) do not compete in one image.
    A contrast of the prompt (another colour, another size if it is visible) competes all the same.
    The trackers, which weigh many images, may separate more things.

    Args:
        prompts: names of the objects to look for.
        things: all things, the prompts first.
        text: the detector's text encoder.

    Returns:
        (2, prompts, things) bool.
    """
    known = words_for(things, text.resolve)
    words = [(thing, known.get(thing, thing)) for thing in things]
    competes = np.ones((2, len(prompts), len(things)), np.bool_)
    for row, prompt in enumerate(prompts):
        contrasts = set(text.contrasts(prompt))
        seen_in_part = set(text.contrasts(prompt, whole=False))
        for column, others in enumerate(words):
            contrast = not contrasts.isdisjoint(others)
            unseen = contrast and seen_in_part.isdisjoint(others)
            near = any(names.look_alike(a, b) for a in words[row] for b in others)
            competes[0, row, column] = contrast or not near
            competes[1, row, column] = competes[0, row, column] and not unseen
    return competes
