"""Canonical names of objects: the alias table for prompts, formulas and worlds.

>>> canonical("the TV set"), canonical("SofaC_01"), canonical("dining_tables")
('television', 'sofa', 'dining table')
>>> same_name("trash bin", "Trash")
True
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache

from edge.errors import UserError
from edge.number_words import ORDINALS, SMALL_NUMBERS, number, ordinal
from edge.text import one_line

MAX_CHARS = 200  # of a name, before it is normalised

ALIASES: dict[str, tuple[str, ...]] = {
    "air conditioner": ("airconditioner", "aircon", "ac unit"),
    "armchair": ("arm chair", "easy chair", "recliner", "lounge chair"),
    "backpack": ("rucksack", "knapsack", "school bag"),
    "basketball": ("basket ball",),
    "bathtub": ("bath tub", "tub"),
    "bed": ("double bed", "single bed", "king bed", "queen bed"),
    "bench": (),
    "bicycle": ("bike", "push bike", "cycle"),
    "bookcase": ("bookshelf", "book shelf", "book case"),
    "bottle": ("flask",),
    "bowl": (),
    "box": ("cardboard box", "carton"),
    "building": (),
    "bus": (),
    "bush": ("shrub", "shrubbery"),
    "cabinet": ("cupboard", "kitchen cabinet", "sideboard", "credenza", "tv cabinet"),
    "candle": (),
    "car": ("automobile",),
    "carpet": ("rug", "area rug"),
    "ceiling lamp": ("chandelier", "pendant lamp", "light fixture", "ceiling light"),
    "cell phone": ("mobile phone", "cellphone", "smartphone", "mobile", "cellular telephone"),
    "chair": ("dining chair", "kitchen chair", "wooden chair", "desk chair", "office chair"),
    "chest of drawers": ("dresser", "drawers", "drawer unit", "commode"),
    "clock": ("wall clock", "alarm clock"),
    "coffee maker": ("coffee machine", "coffeemaker", "espresso machine"),
    "coffee table": ("low table", "tea table"),
    "computer keyboard": ("keyboard",),
    "computer monitor": ("computer screen", "monitor"),
    "countertop": ("counter top", "counter", "worktop", "kitchen counter", "cooking bench"),
    "cup": (),
    "curtain": ("drapes", "drape", "drapery"),
    "cushion": ("throw pillow",),
    "desk": (
        "reading desk", "writing desk", "office desk", "computer desk", "work desk", "study desk",
    ),
    "dining table": ("kitchen table", "dinner table", "kitchen & dining room table"),
    "dishwasher": ("dish washer",),
    "door": ("doorway", "folding door"),
    "dumbbell": ("dumb bell", "hand weight"),
    "fan": ("mechanical fan", "electric fan"),
    "fence": ("fencing", "railing"),
    "fire hydrant": ("hydrant",),
    "fireplace": (),
    "floor lamp": ("standing lamp", "standard lamp"),
    "gate": ("gateway",),
    "handbag": ("purse", "hand bag"),
    "hedge": ("hedgerow",),
    "house": (),
    "houseplant": ("house plant", "potted plant", "pot plant", "plant", "indoor plant"),
    "laptop": ("laptop computer", "notebook computer"),
    "laundry basket": ("laundry hamper", "clothes hamper", "hamper"),
    "mailbox": ("mail box", "letter box", "letterbox", "post box", "postbox"),
    "microwave": ("microwave oven",),
    "mirror": ("looking glass",),
    "motorcycle": ("motorbike", "motor bike"),
    "mug": ("coffee mug", "coffee cup"),
    "nightstand": ("night stand", "bedside table", "night table", "bedside cabinet"),
    "ottoman": ("footstool", "foot stool", "pouffe", "hassock"),
    "oven": (),
    "painting": (
        "picture", "picture frame", "portrait", "desk portrait", "photo frame", "photograph",
        "wall art", "artwork", "framed picture",
    ),
    "parking meter": (),
    "person": ("man", "woman", "human", "people", "pedestrian", "child"),
    "piano": (),
    "pillow": (),
    "plate": ("dish",),
    "pole": ("post",),
    "printer": (),
    "refrigerator": ("fridge", "freezer", "ice box"),
    "remote control": ("remote", "tv remote", "remote controller"),
    "shelf": ("shelves", "shelving unit", "rack", "shelving"),
    "shoe rack": (),
    "shower": (),
    "side table": ("end table", "occasional table"),
    "sign": ("traffic sign", "road sign", "street sign", "signpost"),
    "sink": ("washbasin", "wash basin", "basin", "kitchen sink"),
    "sofa": ("couch", "settee", "loveseat", "love seat", "divan", "chesterfield", "sectional"),
    "sports ball": ("ball", "soccer ball", "football"),
    "statue": ("sculpture", "figurine"),
    "stool": ("bar stool", "barstool"),
    "stop sign": (),
    "stove": ("cooker", "gas stove", "hob", "cooktop", "stovetop", "range"),
    "street light": (
        "streetlight", "street lamp", "streetlamp", "lamp post", "lamppost", "lamp pole",
    ),
    "suitcase": ("luggage", "travel case"),
    "table": (),
    "table lamp": ("desk lamp", "bedside lamp", "lamp"),
    "teddy bear": ("teddy", "stuffed bear", "plush bear"),
    "telephone": ("phone", "landline"),
    "television": ("tv", "tv set", "television set", "telly", "television screen", "tv screen"),
    "tv stand": ("tvstand", "television stand", "media console", "media unit"),
    "toaster": (),
    "toilet": ("wc", "lavatory", "toilet bowl"),
    "towel": ("bath towel", "hand towel"),
    "traffic light": ("stoplight", "traffic signal"),
    "trash can": (
        "trash", "trash bin", "trash bin can", "trashcan", "garbage can", "garbage bin",
        "garbage", "waste bin", "waste container", "waste basket", "wastebasket", "bin",
        "rubbish bin", "dustbin", "wastepaper basket", "litter bin",
    ),
    "tree": (),
    "tree trunk": (),
    "treadmill": ("running machine",),
    "truck": ("lorry",),
    "umbrella": (),
    "van": ("minivan",),
    "vacuum cleaner": ("vacuum", "hoover"),
    "vase": ("flower vase",),
    "wardrobe": ("armoire", "closet"),
    "washing machine": ("washer", "clothes washer", "laundry machine"),
    "window": ("room window",),
    "wine glass": ("wineglass",),
}  # fmt: skip
"""Canonical name → other names for the same object. No name appears twice."""

BROADER: dict[str, tuple[str, ...]] = {
    "armchair": ("chair",),
    "bookcase": ("shelf",),
    "cushion": ("pillow",),
    "bonsai tree": ("houseplant",),
    "bus": ("vehicle",),
    "cactus": ("houseplant",),
    "car": ("vehicle",),
    "desk": ("table",),
    "house": ("building",),
    "motorcycle": ("vehicle",),
    "mug": ("cup",),
    "orchid": ("houseplant",),
    "pillow": ("cushion",),
    "sofa bed": ("sofa", "bed"),
    "stool": ("chair",),
    "street light": ("pole",),
    "truck": ("vehicle",),
    "van": ("vehicle",),
    "yucca": ("houseplant",),
}
"""Canonical name → broader kinds of object, except its last word ("dining table" is a "table")."""

HYPERNYMS: dict[str, tuple[str, ...]] = {
    "plant": ("bush", "hedge", "vegetation", "fern", "ivy", "flower bed"),
    "tree": ("pine", "oak", "fir", "birch", "willow", "sapling", "tree trunk"),
    "building": (
        "shed",
        "garage",
        "shop",
        "store",
        "kiosk",
        "barn",
        "church",
        "school",
        "hospital",
        "hotel",
        "station",
        "warehouse",
        "cabin",
        "chapel",
        "villa",
    ),
    "vehicle": ("trailer", "caravan", "excavator", "bulldozer", "tram", "lawn mower"),
    "car": ("pickup", "sedan", "hatchback", "limousine", "police car"),
    "motorcycle": ("moped",),
    "person": ("cyclist", "rider", "driver", "worker", "visitor", "passenger", "policeman"),
    "pole": ("bollard", "pillar", "mast"),
}
"""Broader word → kinds of it. A detector that lacks the word for a kind looks for the broader one.

A trunk of a tree is where the tree stands. Other parts, and objects that only look alike (fence,
gate), are not in here.
"""

NEAR: dict[str, tuple[str, ...]] = {
    "cabinet": ("chest of drawers", "nightstand", "shelf", "tv stand", "wardrobe"),
    "chest of drawers": ("nightstand", "tv stand", "wardrobe"),
    "countertop": ("table",),
    "cup": ("wine glass",),
    "nightstand": ("side table", "table"),
    "ottoman": ("stool",),
}
"""Canonical name → other objects that look alike in one view; several views may separate them."""

# For `singular`: irregular plural → singular, also at the end of a word, as in "bookshelves".
_PLURALS = {"shelves": "shelf", "knives": "knife", "people": "person", "couches": "couch",
            "cookies": "cookie", "buses": "bus"}  # fmt: skip
# Nouns that `singular` leaves as they are; "glasses" only as eyeglasses.
_PAIRS = ("scissors", "trousers", "headphones", "binoculars", "pliers", "tweezers", "sunglasses")
_EYEGLASSES = ("glasses", "reading glasses", "safety glasses")
_NO_PLURAL = ("ss", "us", "is")  # endings of singular nouns
_ARTICLES = ("a ", "an ", "the ", "some ", "any ", "my ", "our ")
# Words after which a phrase describes the place or the state of its object, such as " next to " in
# "lamp next to the sofa".
_AFTER_HEAD = re.compile(
    r"\s+(?:near|next to|beside|behind|in|inside|on|under|below|above|by|at|with|without|from|"
    r"to|that|which|where|between|against|opposite|close to|in front of)\s+"
)
# Borders between words in CamelCase: "TVStand" is "TV" and "Stand".
_CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
# Suffixes of 3-D models, which are no part of the name: "_01" in "Sofa_01", "_A_2" in "Sofa_A_2";
# "C" in "SofaC". A number after a space is part of the name ("room 12"), but not after "- "
# ("Sofa- 2").
_VARIANT = re.compile(r"(?:(?:_|(?<!\w)\s)+(?:[A-Z]|\d+))+$")
_VARIANT_LETTER = re.compile(r"(?<=[a-z])[A-Z]$")

STOREYS = ("floor", "level", "storey", "story")  # "floor 2" is the "second floor"
_MOST_SPELLED = 10  # largest number that a normalised name has as a word

# Any name in `ALIASES` → the canonical name.
_CANONICAL: dict[str, str] = {name: name for name in ALIASES}
for _name, _others in ALIASES.items():
    for _other in _others:
        _CANONICAL[_other] = _name


class NotANameError(UserError, ValueError):
    """A text that is no object name; the message shows the text and the reason."""


def normalise(word: str) -> str:
    """Return the name in lower case, with single spaces, no article and no model suffix.

    `SofaC_01` becomes `sofa`. A number at the end is part of the name. Numbers up to ten become
    words, larger ones digits: "room 2" becomes "room two", "room twelve" becomes "room 12".
    "Floor 2" becomes "second floor". Prompts, formulas, worlds and vocabularies accept exactly
    these names.

    Raises:
        NotANameError: there is no letter or digit, there is a non-printing character (line break,
            escape, change of writing direction), or there are more than `MAX_CHARS` characters.
    """
    if len(word) > MAX_CHARS:
        raise NotANameError(f"{_quoted(word)} is no name: it has more than {MAX_CHARS} characters")
    if not word.isprintable():
        at = next(i for i, c in enumerate(word) if not c.isprintable())
        raise NotANameError(
            f"{_quoted(word)} is no name: character {at + 1} (U+{ord(word[at]):04X}) does not print"
        )
    text = _tidy(word)
    while (again := _tidy(text)) != text:  # one pass may expose more to remove
        text = again
    if not any(map(str.isalnum, text)):
        raise NotANameError(f"{_quoted(word)} is no name: it needs a letter or a digit")
    return text


@lru_cache(maxsize=4096)
def _tidy(word: str) -> str:
    """Do one pass of `normalise`."""
    text = _VARIANT_LETTER.sub("", _VARIANT.sub("", word.strip()))
    text = " ".join(_CAMEL.sub(" ", re.sub(r"[_\-]+", " ", text)).split())
    text = text.lower().strip(" .,;:!?'\"")
    for article in _ARTICLES:
        text = text.removeprefix(article)
    return _normalise_number(text)


def _normalise_number(text: str) -> str:
    """Return the name with its number in the form that `normalise` documents."""
    words = text.split(" ")
    if len(words) < 2:
        return text
    # The last word or the last two ("twenty one") may be a number. Else the first of two may be an
    # ordinal ("2nd floor").
    head, n = words[:-1], number(words[-1:])
    if n is not None and len(head) > 1 and (tens := number(words[-2:])) is not None:
        head, n = words[:-2], tens
    if n is None:
        storey = len(words) == 2 and words[1] in STOREYS
        n = ordinal(words[0]) if storey else None
        head = words[1:]
    if n is None:
        return text
    if len(head) == 1 and head[0] in STOREYS and 0 < n <= len(ORDINALS):
        return f"{ORDINALS[n - 1]} {head[0]}"
    if words[-1].isdecimal() and words[-1] != str(n):
        return text  # digits with leading zeros stay: "room 007"
    is_spelled = n <= _MOST_SPELLED and head[-1] != "of"  # "chair 1 of 2"
    return " ".join([*head, SMALL_NUMBERS[n] if is_spelled else str(n)])


def _quoted(word: str) -> str:
    return f"'{one_line(word, 60)}'"


def singular(phrase: str) -> str:
    """Return the phrase with its last word in the singular, by the usual English endings.

    >>> singular("dining chairs"), singular("boxes"), singular("glass")
    ('dining chair', 'box', 'glass')
    """
    head, _, last = phrase.rpartition(" ")
    if last in _PAIRS or phrase in _EYEGLASSES:
        return phrase
    irregular = next((word for word in _PLURALS if last.endswith(word)), None)
    if irregular:
        last = last.removesuffix(irregular) + _PLURALS[irregular]
    elif last.endswith("ies") and len(last) > 4:
        last = last[:-3] + "y"
    elif last.endswith(("ches", "shes", "xes", "sses")):
        last = last[:-2]
    elif last.endswith("s") and not last.endswith(_NO_PLURAL) and len(last) > 3:
        last = last[:-1]
    if not last[-1:].isalpha():  # 1990s is no plural
        return phrase
    return f"{head} {last}" if head else last


def plural(phrase: str) -> str:
    """Return the phrase with its last word in the plural, by the usual English endings.

    >>> plural("dining chair"), plural("box"), plural("toy shelf"), plural("scissors")
    ('dining chairs', 'boxes', 'toy shelves', 'scissors')
    >>> plural("bookshelf"), plural("penknife"), plural("roof"), plural("jeans")
    ('bookshelves', 'penknives', 'roofs', 'jeans')
    """
    head, space, last = phrase.rpartition(" ")
    if last in _PAIRS or phrase in _EYEGLASSES or singular(last) != last:
        return phrase
    ending = "es" if last.endswith(("s", "x", "ch", "sh")) else "s"
    stem = re.sub(r"(?<=el|al|ea|oa|ar|ni|li|wi)(?:f|fe)$", "ve", last)
    regular = re.sub(r"(?<![aeiou])y$", "ie", stem) + ending
    return head + space + next((many for many, one in _PLURALS.items() if one == last), regular)


def is_name(text: str) -> bool:
    """Return True if a text is an object name; see `normalise`."""
    try:
        return bool(normalise(text))
    except NotANameError:
        return False


def is_known(word: str) -> bool:
    """Return True if the alias table has the word, in the singular or plural."""
    if not is_name(word):
        return False
    text = normalise(word)
    return text in _CANONICAL or singular(text) in _CANONICAL


def is_alias(word: str) -> bool:
    """Return True if the alias table has exactly this word, which is not normalised first."""
    return word in _CANONICAL


@lru_cache(maxsize=4096)
def canonical(word: str) -> str:
    """Return the canonical name; an unknown word is normalised and made singular."""
    text = normalise(word)
    if text in _CANONICAL:
        return _CANONICAL[text]
    return _CANONICAL.get(singular(text), singular(text))


def hypernym(word: str) -> str | None:
    """Return the broader word that stands for a kind in `HYPERNYMS`; None if there is none.

    >>> hypernym("bushes"), hypernym("trunk")
    ('plant', None)
    """
    name = canonical(word)
    return next((broader for broader, kinds in HYPERNYMS.items() if name in kinds), None)


def same_name(a: str, b: str) -> bool:
    """Return True if two words are names of the same object."""
    return canonical(a) == canonical(b)


def same_as_any(name: str, others: Iterable[str]) -> bool:
    """Return True if a name is another word for one of `others`."""
    return any(same_name(name, other) for other in others)


def names_of(word: str) -> tuple[str, ...]:
    """Return all names of an object: the word, its canonical name, then the aliases."""
    text, name = normalise(word), canonical(word)
    return tuple(dict.fromkeys((text, singular(text), name, *ALIASES.get(name, ()))))


def is_kind_of(word: str, broader: str) -> bool:
    """Return True if a word names the same object as `broader`, or a kind of it.

    >>> is_kind_of("folding chair", "chair"), is_kind_of("armchair", "chair")
    (True, True)
    >>> is_kind_of("chair", "armchair")
    False
    """
    wanted = canonical(broader)
    nouns = [canonical(noun) for noun in head_nouns(word)]
    return wanted in nouns or any(wanted in BROADER.get(noun, ()) for noun in nouns)


def may_be_same_object(a: str, b: str) -> bool:
    """Return True if two words may name one object: the same name, or a kind of the other.

    >>> may_be_same_object("chair", "armchair"), may_be_same_object("sofa", "armchair")
    (True, False)
    """
    return is_kind_of(a, b) or is_kind_of(b, a)


def look_alike(a: str, b: str) -> bool:
    """Return True if two objects are hard to tell apart: `may_be_same_object`, or listed in `NEAR`.

    >>> look_alike("wardrobe", "cabinet"), look_alike("bed", "sofa")
    (True, False)
    """
    x, y = canonical(a), canonical(b)
    return may_be_same_object(a, b) or y in NEAR.get(x, ()) or x in NEAR.get(y, ())


def non_targets(words: Iterable[str], targets: Sequence[str]) -> tuple[str, ...]:
    """Return the canonical names that are no target and no kind of a target, each once.

    >>> non_targets(("couch", "sofa", "armchair", "lamp"), ("chair",))
    ('sofa', 'table lamp')
    """
    return tuple(
        word
        for word in dict.fromkeys(map(canonical, words))
        if not any(is_kind_of(word, target) for target in targets)
    )


def head_phrase(phrase: str) -> str:
    """Return the part of a phrase that names the object.

    Raises:
        NotANameError: the phrase is no name, or has no such part.

    >>> head_phrase("the tall white trash bin next to the sofa")
    'tall white trash bin'
    """
    head = _AFTER_HEAD.split(normalise(phrase), maxsplit=1)[0]
    if not is_name(head):
        raise NotANameError(f"{_quoted(phrase)} is no name: it has a place but no object")
    return head


def head_nouns(phrase: str) -> Iterator[str]:
    """Yield shorter and shorter endings of the head phrase that are names.

    The first known one is the noun of the phrase.

    >>> list(head_nouns("tall white trash bin"))
    ['tall white trash bin', 'white trash bin', 'trash bin', 'bin']
    """
    words = head_phrase(phrase).split()
    yield from filter(is_name, (" ".join(words[start:]) for start in range(len(words))))
