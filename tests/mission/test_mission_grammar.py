"""Controlled English: sentences and the formulas they must mean."""

from __future__ import annotations

import contextlib
from functools import cache

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from edge.config import TranslatorAuto, TranslatorGrammar
from edge.lab.eval.equivalence import distinguishing_trace
from edge.mission.language.grammar.instruction import TranslationError, readings
from edge.mission.language.words.lexicon import PHRASES, TABLE
from edge.mission.language.words.tokens import MAX_CHARS, MAX_WORDS
from edge.mission.logic.ltl import Formula, ap, eventually, parse, to_text
from edge.mission.readings import AmbiguousInstructionError, distinct
from edge.mission.translate import Translator, make_translator

_TRANSLATOR = make_translator(TranslatorGrammar())


def parse_english(text: str) -> Formula:
    """Return the formula that is chosen without a person to ask."""
    return _TRANSLATOR.translate(text, ask=False).formula


VITL = [  # the paper's own sentences (III, V-C), the until weak
    ("Reach either a chair or a couch, then reach a tv.", "F((chair | sofa) & F television)"),
    (
        "Reach a bed, then a tv, then a couch; or reach a toilet, then a chair",
        "F(bed & F(television & F sofa)) | F(toilet & F chair)",
    ),
    (
        "Reach a toilet and then a bed; or reach a couch and then a chair; or reach a potted plant "
        "and then a tv. Do not reach a tv until a bed is reached, and do not reach a toilet until "
        "a couch is reached, and do not reach a couch until a tv is reached.",
        "(F(toilet & F bed) | F(sofa & F chair) | F(houseplant & F television)) & "
        "(!television W bed) & (!toilet W sofa) & (!sofa W television)",
    ),
    (
        "Reach a couch and then a toilet and then a bed and then a chair; or reach a bed and then "
        "either a potted plant or a toilet; or reach a tv and then a potted plant and then a "
        "couch. Do not reach a couch until a toilet is reached, and do not reach a bed until a tv "
        "is reached, and do not reach a potted plant until a chair is reached.",
        "(F(sofa & F(toilet & F(bed & F chair))) | F(bed & F(houseplant | toilet)) | "
        "F(television & F(houseplant & F sofa))) & (!sofa W toilet) & (!bed W television) & "
        "(!houseplant W chair)",
    ),
    (
        "clean either the chair or the couch, then turn on the tv; don't go to the bed before that",
        "F((chair | sofa) & F television) & (!bed W television)",
    ),
]

HOUSEHOLD = [
    ("Could you please find the fridge?", "F refrigerator"),
    ("I want you to check the stove", "F stove"),
    ('visit the "bed frame"', 'F "bed frame"'),
    ("In any order, clean the sink, the oven, and the shower.", "F sink & F oven & F shower"),
    ("Visit both the bed and the tv; the order does not matter.", "F bed & F television"),
    ("either the bed or the sofa, and the tv", "F(bed | sofa) & F television"),
    ("go to the bed and the chair, then the tv", "F(bed & F television) & F(chair & F television)"),
    ("visit the bed, the chair and the tv in this order", "F(bed & F(chair & F television))"),
    (
        "visit the bed and the tv in exactly this order",
        "F(bed & F television) & (!television W bed)",
    ),
    ("before going to the tv, visit the bed", "F(bed & F television) & (!television W bed)"),
    ("once you have visited the bed, go to the tv", "F(bed & F television)"),
    ("go to the tv only after you have cleaned the sink", "F television & (!television W sink)"),
    ("go to the sink and only then go to the tv", "F(sink & F television) & (!television W sink)"),
    ("don't visit the tv without visiting the bed", "!television W bed"),
    ("you must not enter the shower, and visit the bed", "G !shower & F bed"),
    ("the stove must be avoided", "G !stove"),
    ("visit the bed while avoiding the tv, then the sofa", "F(bed & F sofa) & (!television W bed)"),
    (
        "go to the bed but do not go to the tv, then go to the tv",
        "F(bed & F television) & (!television W bed)",
    ),
    ("go to the bed, then avoid the stove", "F bed & G(bed -> G !stove)"),
    ("check the door at most once", "!F(door & F(!door & F door))"),
    ("never go to the door more than once", "!F(door & F(!door & F door))"),
    ("go to the bed, then to the bed", "F(bed & X F bed)"),
    (
        "check the door exactly once, then the window",
        "F(door & F window) & (!door W (door W (!door W window)))",
    ),
    ("find the cat, and never touch it again", "F cat & !F(cat & F(!cat & F cat))"),
    ("Bring me the mug; do not go near the stove.", "F mug & G !stove"),
    ("First, clean the table; second, turn off the oven.", "F(table & F oven)"),
    ("Go to the bed, but first go to the sofa.", "F(sofa & F bed)"),
    ("Go to the bed; do not visit the sofa afterwards.", "F bed & G(bed -> G !sofa)"),
    ("Go to the bed and, after that, to the sofa.", "F(bed & F sofa)"),
    ("visit neither the bed nor the sofa", "G !bed & G !sofa"),
    ("avoid all chairs", "G !chair"),
    (
        "visit the bed, then the sofa without going back to the bed",
        "F(bed & F sofa) & (!bed W (bed W (!bed W sofa)))",
    ),
    ("Visit the sofa and the desk, but the desk first.", "F(desk & F sofa)"),
    (
        "Visit the bed and then the sofa, or the desk and then the tv.",
        "F(bed & F sofa) | F(desk & F television)",
    ),
    (
        "Visit the bed, sofa, and desk in any order, but avoid the tv until all are visited.",
        "F bed & F sofa & F desk & (!television W bed) & (!television W sofa) & "
        "(!television W desk)",
    ),
    ("The robot must visit the bed, please.", "F bed"),
    ("Visit the bed. Then, once you have been there, go to the sofa.", "F(bed & F sofa)"),
    ("The bed and the sofa should both be visited.", "F bed & F sofa"),
    ("do not stop until the bed and the tv are visited", "F bed & F television"),
    ("you can go to the bed, but you must visit the sink after that", "G(bed -> F sink)"),
]

LETTERS = [  # ../shared/nl2ltl writes letters, without commas; `a` is also an article
    ("visit a b and c", "F a & F b & F c"),
    ("go to a b c d and h in any order", "F a & F b & F c & F d & F h"),
    ("visit a then go to b finally make your way to c", "F(a & F(b & F c))"),
    ("find b but not until you find a first", "F b & (!b W a)"),
    ("you cannot visit a less than twice", "F(a & F(!a & F a))"),
    ("you must go to b immediately after you visit a", "G(a -> X b)"),
]


ON_THE_WAY = [
    ("while avoiding the sofa, go to the bed", "F bed & G !sofa"),
    ("dont take the hallway to get to the bed", "F bed & G !hallway"),
    ("go to the bed but do not use the hallway to get there", "F bed & G !hallway"),
    ("go to the bed but do not enter the hallway first", "F bed & (!hallway W bed)"),
    ("go to the bed via the hallway", "F(hallway & F bed)"),
    ("drive through the hallway and into the bedroom", "F(hallway & F bedroom)"),
    ("on the way to the bed, visit the sofa", "F(sofa & F bed)"),
    ("go to the bed or the sofa to the door", "F((bed | sofa) & F door)"),
    ("do not go through the hallway towards the bed", "F bed & G !hallway"),
    ("the robot goes through the hallway and ends up in the bedroom", "F(hallway & F bedroom)"),
    ("make three distinct visits to the sofa on your travels",
     "F(sofa & F(!sofa & F(sofa & F(!sofa & F sofa))))"),
    ("go to the sofa go to the bed", "F(sofa & F bed)"),
    ("visit the sofa, go to the bed, and return to the sofa", "F(sofa & F(bed & F sofa))"),
    ("visit the sofa at least once and at most twice", "F sofa & !F(sofa & F(!sofa & F(sofa & "
     "F(!sofa & F sofa))))"),
    ("Go to the sofa. If you have reached the sofa, then you may go to the bed.", "F sofa"),
    ("go to landmark two", 'F "landmark two"'),
    ("go to the second floor and then to room 3", 'F ("second floor" & F "room three")'),
]  # fmt: skip


@pytest.mark.parametrize(("sentence", "formula"), [*VITL, *HOUSEHOLD, *LETTERS, *ON_THE_WAY])
def test_means(sentence: str, formula: str) -> None:
    """The language is the expected one, and the formula's text parses back to it."""
    got = parse_english(sentence)
    assert distinguishing_trace(got, parse(formula)) is None, f"{sentence!r} gave {got}"
    assert parse(to_text(got)) == got


REFUSED = [
    ("", ""),
    ("dance with the bed", "dance"),
    ("go to the bed frame", "frame"),
    ("fetch the cup to the table", "to the table"),
    ("do not go to the tv before that", "that"),
    ("visit it", "it"),
    ("go to", ""),
    ("go to a tall, white trash can", "tall"),
    ("visit the bed and the bed", "the bed and the bed"),
    ("find my keys and bring them to me", "to me"),
    ("do not visit the bed until the sofa is reached, or the desk", "the desk"),
    ("only visit the bed", "only visit the bed"),
    ("go upstairs", "upstairs"),
    ("visit every chair", "every chair"),
    ("visit two chairs", "two chairs"),
    ("keep visiting the bed", "keep visiting the bed"),
    ("visit the bed forever", "forever"),
    ("go to the bed until the tv is reached", "until the tv is reached"),
    ("visit the bed 999999999999 times", "999999999999 times"),
    ("go to the bed @ noon", "@ noon"),
    ("go to the bed, otherwise to the sofa", "otherwise to the sofa"),
    ("do not visit the bed until you visit the bed", "until you visit the bed"),
    ("visit the bed at least three times but at most twice", "but at most twice"),
    ("you don't have to go to the bed", "don't have to go to the bed"),
    ("you need not go to the bed", "need not go to the bed"),
    ("if you never find the sofa, go to the bed", "if you never find the sofa"),
    ("if the door is open, go to the bed", "open"),
    ("go to the bed only after visiting the sofa twice", "after visiting the sofa twice"),
    ("turn left", "left"),
    ("go to the sofa after dinner", "dinner"),
    ("go to the sofa in the morning", "in the morning"),
    ("go to a spot in the bed", "spot in the bed"),
    ("look for robot c", "robot c"),
    ("go to the tv but only after visiting the bed and the sofa in that specific order",
     "go to the tv but only after visiting the bed and the sofa in that specific order"),
    ("robot c", "robot c"),
    ("go to the bed without changing floors", "changing floors"),
    ("go to the blorf chair", "blorf chair"),
    ("go to the chair next to the window", "chair next to the window"),
    ("either go to the bed or go to the sofa, then the tv", "go to the bed or go to the sofa"),
    ("do not go to the bed first", "do not go to the bed first"),
]  # fmt: skip


@pytest.mark.parametrize(("sentence", "part"), REFUSED)
def test_refuses_by_name(sentence: str, part: str) -> None:
    """The error quotes the unknown words and their position."""
    with pytest.raises(TranslationError) as refusal:
        parse_english(sentence)
    error = refusal.value
    assert error.part == part
    assert sentence[error.position - 1 :].startswith(part)
    assert "\n" not in str(error)


@pytest.mark.parametrize(
    ("sentence", "reason"),
    [
        ("keep visiting the bed", "a patrol needs two stops"),
        ("wait at the door", "not stay or leave"),
        ("go to the bed and continue", "say where to go"),
        ("visit the bed forever", "a mission ends"),
        ("visit the bed frame", '"bed frame"'),
        ("go to the firdge", "firdge: fridge\\?"),
        ("go to teh kitchn", "kitchn: kitchen\\?"),
        ("turn left and go to the bed", "'left': unknown word, and not an object"),
        ("find out whether the lamp is on", "'whether': unknown word, and not an object"),
        ("go to the sofa after an hour", "times and distances cannot be used"),
        ("go to the bed \x1b", "U\\+001B"),
        ("Geh zum Sofa und dann zum Bett.", "in English only"),
        ("Va au canapé puis au lit", "in English only"),
        ("去沙发，然后去床", "in English only"),
    ],
)
def test_says_why(sentence: str, reason: str) -> None:
    with pytest.raises(TranslationError, match=reason):
        parse_english(sentence)


AMBIGUOUS = [  # all readings, and the index of the one that implies the others
    ("go to the bed before the sofa", ["F (bed & F sofa) & (!sofa W bed)"], None),
    ("you must go to the bed and the desk before the sofa",
     ["F (bed & F sofa) & F (desk & F sofa) & (!sofa W bed) & (!sofa W desk)"], None),
    ("the bed must be visited before the sofa is visited",
     ["F (bed & F sofa) & (!sofa W bed)", "F bed & (!sofa W bed)", "F (bed & F sofa)"], 0),
    ("go to the bed before you may go to the sofa",
     ["F (bed & F sofa) & (!sofa W bed)", "F bed & (!sofa W bed)", "F (bed & F sofa)"], 0),
    ("go to the bed without the sofa, then to the tv",
     ["F (bed & F television) & (!sofa W bed)", "F (bed & F television) & G !sofa"], 1),
    ("go to the bed without the sofa, then to the sofa",
     ["F (bed & F sofa) & (!sofa W bed)"], None),
    ("visit either the bed or the sofa, and the tv", ["F (bed | sofa) & F television"], None),
    ("go to the bed and go to the sofa", ["F bed & F sofa", "F (bed & F sofa)"], 1),
    ("visit the bed and check the sofa", ["F bed & F sofa"], None),
    ("do not go to the tv until you have been to the bed",
     ["!television U bed", "F television & (!television W bed)"], 1),
    ("until the bed is reached, stay away from the tv", ["!television U bed"], None),
    ("do not reach the tv or the sofa before the bed",
     ["F bed & (!television W bed) & (!sofa W bed)",
      "F television & F sofa & (!television W bed) & (!sofa W bed)"], 1),
    ("do not reach the tv until either the bed or the sofa is reached",
     ["!television U (bed | sofa)", "F television & (!television W (bed | sofa))"], 1),
    ("do not go to the bed until after the sofa; visit the tv", ["F television & (!bed W sofa)"],
     None),
    ("go to the bed and go through the hall", ["F (hall & F bed)", "F bed & F hall"], 0),
    ("visit the bed once", ["F bed", "F bed & !F (bed & F (!bed & F bed))"], 1),
    ("visit the bed at least once", ["F bed"], None),
]  # fmt: skip


@pytest.mark.parametrize(("sentence", "formulas", "safer"), AMBIGUOUS)
def test_every_reading_is_found(sentence: str, formulas: list[str], safer: int | None) -> None:
    got, implied = distinct(readings(sentence))
    assert implied == safer
    for one, expected in zip(got, formulas, strict=True):
        assert distinguishing_trace(one, parse(expected)) is None, f"{one} is not {expected}"


def test_too_many_readings_are_refused() -> None:
    steps = (f"room {i} must be visited before landmark {i}" for i in range(1, 6))
    with pytest.raises(TranslationError, match="too many possible meanings"):
        readings(". ".join(steps))


ACCEPTED = [sentence for sentence, _ in (*HOUSEHOLD, *ON_THE_WAY) if '"' not in sentence]


@pytest.mark.parametrize("sentence", ACCEPTED)
def test_no_unknown_word_is_skipped(sentence: str) -> None:
    """In place of any word and between any two; words alone, so no punctuation helps."""
    words = sentence.split()
    for i in range(len(words) + 1):
        for rest in (words[i:], words[i + 1 :]):
            with pytest.raises(TranslationError):
                parse_english(" ".join([*words[:i], "blorf", *rest]))


# Clauses over two objects; a word that means something is marked by a star.
CLAUSES = (
    "visit the *A", "go to the *A", "please check the *A too", "visit the *A *twice",
    "visit the *A at *most *twice", "visit the *A *exactly *three *times",
    "do *not visit the *A", "*never go to the *A", "*avoid the *A", "you must *not enter the *A",
    "visit either the *A *or the *B", "visit the *A and the *B", "visit the *A *before the *B",
    "visit the *A while *avoiding the *B", "visit the *A *without visiting the *B",
    "do *not visit the *A *until you visit the *B", "go through the *A *to the *B",
    "*only go to the *A *if you have been to the *B", "visit the *A via the *B",
    "*once you have seen the *A you *must visit the *B", "find *neither the *A nor the *B",
    "stop at the *A on the way *to the *B",
    "visit the *A, *passing the *B", "visit the *A but *only *after the *B",
    "at *no point enter the *A",
    "visit the *A by going *through the *B", "keep going *until you reach the *A",
    "the *maximum number of visits to the *A is *two",
    "visit the *A in the *end", "always *avoid the *A",
)  # fmt: skip
JOINTS = (", then ", " and finally ", ". ")


@st.composite
def sentences(draw: st.DrawFn) -> tuple[list[str], list[int]]:
    """Return the words of an instruction, and the positions of meaningful ones."""
    nouns = iter(draw(st.permutations(["sofa", "bed", "tv", "oven", "desk", "lamp"])))
    said = ""
    for n in range(draw(st.integers(1, 3))):
        clause = draw(st.sampled_from(CLAUSES))
        for letter in "AB":
            clause = clause.replace(f"*{letter}", f"*{next(nouns)}" if letter in clause else "")
        said += (draw(st.sampled_from(JOINTS)) if n else "") + clause
    return starred(said)


def starred(said: str) -> tuple[list[str], list[int]]:
    """Return the words of a sentence, and the positions of marked ones."""
    words = said.split()
    stars = [i for i, word in enumerate(words) if word.startswith("*")]
    return [word.removeprefix("*") for word in words], stars


def meant(words: list[str]) -> tuple[Formula, ...]:
    """Return the possible meanings; empty if the instruction is refused."""
    with contextlib.suppress(TranslationError):
        return distinct(readings(" ".join(words)))[0]
    return ()


def changed_at(words: list[str], at: int, swapped: str) -> list[str]:
    """Put another word in the place of one, or none; the full stop or comma behind it stays."""
    joint = words[at][len(words[at].rstrip(".,")) :]
    if not swapped and joint and at:
        return [*words[: at - 1], words[at - 1] + joint, *words[at + 1 :]]
    return [*words[:at], *([swapped + joint] if swapped else []), *words[at + 1 :]]


def check_counts(words: list[str], at: int, swapped: str) -> None:
    """Check that dropping or replacing each word changes the meaning or raises an error."""
    read = meant(words)
    changed = changed_at(words, at, swapped)
    again = meant(changed)
    if read and again:
        assert len(read) != len(again) or any(
            distinguishing_trace(one, other) is not None
            for one, other in zip(read, again, strict=True)
        ), f"{' '.join(changed)!r} means as much as {' '.join(words)!r}"


@pytest.mark.parametrize("clause", CLAUSES)
def test_each_meaningful_word_counts(clause: str) -> None:
    words, stars = starred(clause.replace("*A", "*sofa").replace("*B", "*bed"))
    assert meant(words)
    for at in stars:
        for swapped in ("", "fridge"):
            check_counts(words, at, swapped)


@given(sentences(), st.data())
def test_no_meaningful_word_is_skipped(sentence: tuple[list[str], list[int]], data) -> None:
    words, stars = sentence
    at, swapped = data.draw(st.sampled_from(stars)), data.draw(st.sampled_from(["", "fridge"]))
    check_counts(words, at, swapped)


@cache
def auto() -> Translator:
    return make_translator(TranslatorAuto())


@given(sentences(), st.data())
def test_the_auto_translator_skips_no_meaningful_word(sentence, data) -> None:
    words, stars = sentence
    at, swapped = data.draw(st.sampled_from(stars)), data.draw(st.sampled_from(["", "fridge"]))
    with contextlib.suppress(TranslationError):
        whole = auto().translate(" ".join(words)).formula
        changed = " ".join(changed_at(words, at, swapped))
        assert distinguishing_trace(whole, auto().translate(changed).formula) is not None, changed


@pytest.mark.parametrize("filler", PHRASES["filler"])
def test_words_that_mean_nothing_change_nothing(filler: str) -> None:
    """Each stands somewhere: in front, behind the verb's object, or after the mood."""
    said = (
        f"{filler} go to the bed",
        f"go to the bed {filler}",
        f"you must {filler} go to the bed",
    )
    read = [found for text in said if (found := meant(text.split()))]
    assert read
    assert set(read) == {(eventually(ap("bed")),)}


def test_limits_are_named() -> None:
    for text in ("x" * (MAX_CHARS + 1), "a " * (MAX_WORDS + 1)):
        with pytest.raises(TranslationError, match=r"at most|more than"):
            parse_english(text)


def test_exponential_formulas_are_refused() -> None:
    """Each step of two objects doubles the formula."""
    for steps in (3, 100):
        text = "visit " + ", then ".join(f'the "x{i}" and the "y{i}"' for i in range(steps))
        if steps == 3:
            assert parse_english(text)
        else:
            with pytest.raises(TranslationError, match="too large"):
                parse_english(text)


def test_long_instructions_are_read() -> None:
    """No recursion by length: 200 steps."""
    names = [f'"thing {chr(97 + i // 26)}{chr(97 + i % 26)}"' for i in range(200)]
    formula = parse_english(", then ".join(f"visit {name}" for name in names))
    assert to_text(formula).count("F ") == 200


WORDS = st.sampled_from(
    [*sorted({word for phrase in TABLE for word in phrase}), "bed", "a", "b", "tv", *',.;"7']
)


BYTES = st.binary(max_size=200).map(lambda raw: raw.decode("utf-8", "surrogateescape"))
EXTREMES = ("\0", "go to the \x1b[31mbed", "x" * 100_000, "(" * 100_000, "visit the " + "y" * 9_000,
            'visit the "' + "z" * 9_000 + '"', "\u202ego to the bed", "é" * 9_000)  # fmt: skip
MAX_REFUSAL = 400
_ECHO = 110


SAID = st.sampled_from(sorted({phrase for listed in PHRASES.values() for phrase in listed}))
NAMED = st.sampled_from(("the sofa", "bed", "a", "third floor", '"x y"', '""', "it", "there"))
JUMBLES = st.lists(st.one_of(SAID, NAMED, st.sampled_from(",.;:?!")), max_size=9).map(" ".join)


@given(st.one_of(st.text(max_size=200), BYTES, st.lists(WORDS, max_size=40).map(" ".join), JUMBLES))
@example("repeated visits are not allowed is forbidden on the route to there a ;")
@example("third floor or single beginning in chair")
@example("go to the sofa, .")
def test_any_text_is_read_or_refused(text: str) -> None:
    """Never anything but a formula that can be written, or a refusal of one line."""
    try:
        formula = parse_english(text)
    except AmbiguousInstructionError as error:
        assert str(error).isprintable()  # noqa: PT017
    except TranslationError as error:
        assert str(error).isprintable()  # noqa: PT017
        assert len(str(error)) < MAX_REFUSAL  # noqa: PT017
    else:
        assert parse(to_text(formula)) == formula


@pytest.mark.parametrize("text", EXTREMES, ids=range(len(EXTREMES)))
def test_a_refusal_shows_little_of_the_text(text: str) -> None:
    with pytest.raises(TranslationError) as refusal:
        parse_english(text)
    shown = str(refusal.value)
    assert shown.isprintable()
    assert max(shown.count(letter) for letter in "xyzé(") < _ECHO


@given(st.sampled_from(sorted(TABLE)), st.sampled_from(["", " bed", " a", ",", ", then"]))
def test_repetition_is_answered_in_time(phrase: tuple[str, ...], between: str) -> None:
    """The same words over and over, as many as are allowed, are answered all the same."""
    text = ((" ".join(phrase) + between + " ") * MAX_WORDS)[:MAX_CHARS]
    with contextlib.suppress(TranslationError):
        assert parse_english(text)
