"""Text classes of a detector: the prompts, the context words, and words that compete with them.

A class is an object to look for; it has one text for each of its names (sofa: "sofa", "couch"). The
network scores an image for each text.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edge import names
from edge.perception.embedding.text import TextEncoder, words_for


@dataclass(frozen=True, slots=True, eq=False)
class TextClasses:
    """The texts whose embeddings a detector's network compares with an image.

    The score of a class is the best score of its texts. Classes are the prompts, then the context
    words, then other words that compete with a prompt.

    Attributes:
        words: the texts of all classes, in the order of the classes.
        class_of_text: (texts,) int32, index of each text's class, ascending.
        context: canonical names of the classes from `len(prompts)` on.
        competes: (2, prompts, classes) bool, True if a class is another object than the prompt
            names. Row 0 is for an object entirely in view, row 1 for an object that the image
            border cuts off.
    """

    words: tuple[str, ...]
    class_of_text: np.ndarray
    n_classes: int
    context: tuple[str, ...]
    competes: np.ndarray


def text_classes_for(
    prompts: Sequence[str], background: Sequence[str], text: TextEncoder, independent: bool = False
) -> TextClasses:
    """Collect the text classes of prompts.

    Args:
        prompts: names of the objects to look for.
        background: further words, all known to the encoder.
        text: the detector's text encoder.
        independent: True: a prompt competes with another only if it is a background word, as if
            each were the only prompt.

    Raises:
        PromptError: see `TextEncoder.resolve`.
    """
    context: dict[str, list[str]] = {}  # canonical name → the background words with this name
    context_names = names.non_targets(background, prompts)
    for word in background:
        context.setdefault(names.canonical(word), []).append(word)
    # A kind of one prompt's object may still compete with another prompt.
    rest = [word for word in background if names.canonical(word) not in context_names]
    rest += [c for prompt in prompts for c in text.contrasts(prompt)]
    rest = [word for word in dict.fromkeys(rest) if word not in prompts]
    named = [*prompts, *context_names, *rest]
    competes = competing_classes(prompts, named, text)
    if independent:
        in_background = [names.canonical(prompt) in context for prompt in prompts]
        competes[:, :, : len(prompts)] &= np.array(in_background, np.bool_)
    # Drop words that compete with nothing: they would only cost time.
    useful = competes.any(axis=(0, 1))
    useful[: len(prompts) + len(context_names)] = True
    classes = [[prompt, *text.synonyms(prompt)] for prompt in prompts]
    classes += [context[name] for name in context_names]
    classes += [[word] for word in rest]
    classes = [texts for texts, kept in zip(classes, useful, strict=True) if kept]
    return TextClasses(
        tuple(word for texts in classes for word in texts),
        np.repeat(np.arange(len(classes), dtype=np.int32), [len(texts) for texts in classes]),
        len(classes),
        context_names,
        np.ascontiguousarray(competes[:, :, useful]),
    )


def competing_classes(
    prompts: Sequence[str], classes: Sequence[str], text: TextEncoder
) -> np.ndarray:
    """Return which classes compete with which prompt; see `TextClasses.competes`.

    Two objects that look almost alike in one view (`names.look_alike`) do not compete in one image.
    A contrast of the prompt (another colour, another size if it is visible) competes all the same.
    The trackers, which weigh many images, may separate more objects.

    Returns:
        (2, prompts, classes) bool.
    """
    # Each name in two forms: as given, and as the text encoder reads it.
    known = words_for(classes, text.resolve)
    forms = [(name, known.get(name, name)) for name in classes]
    competes = np.ones((2, len(prompts), len(classes)), np.bool_)
    for row, prompt in enumerate(prompts):
        contrasts = set(text.contrasts(prompt))
        visible_in_part = set(text.contrasts(prompt, in_full=False))
        for column, others in enumerate(forms):
            is_contrast = not contrasts.isdisjoint(others)  # one of both forms is a contrast
            # A contrast, such as the height, that cannot be seen if the object is cut off.
            is_hidden = is_contrast and visible_in_part.isdisjoint(others)
            look_alike = any(names.look_alike(a, b) for a in forms[row] for b in others)
            competes[0, row, column] = is_contrast or not look_alike
            competes[1, row, column] = competes[0, row, column] and not is_hidden
    return competes
