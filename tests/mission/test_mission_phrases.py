"""Families of English of going places, thought up from general English, not from a corpus.

Each row stands for many: another verb or another place must not matter.
"""

from __future__ import annotations

import pytest

from edge.lab.eval.equivalence import distinguishing_trace
from edge.mission.language.grammar.instruction import TranslationError, readings
from edge.mission.logic.ltl import Formula, parse
from edge.mission.readings import distinct

THROUGH = [
    ("go to the window, passing the sofa", "F (sofa & F window)"),
    ("go to the window, stopping at the sofa on the way", "F (sofa & F window)"),
    ("to reach the school, first go through the park", "F (park & F school)"),
    ("move through the hallway until you reach the bedroom", "F (hallway & F bedroom)"),
    ("go through the kitchen, then through the hallway, to the bedroom",
     "F (kitchen & F (hallway & F bedroom))"),
    ("go up to the third floor via the yellow room", 'F ("yellow room" & F "third floor")'),
    ("go to the second floor by the stairs", 'F (stair & F "second floor")'),
    ("your goal is the window, but you have to go through the hallway", "F (hallway & F window)"),
]  # fmt: skip

SEQUENCES = [
    ("go to the kitchen, and go to the hallway in the end", "F (kitchen & F hallway)"),
    ("go to red room 1st, blue room 2nd", 'F ("red room" & F "blue room")'),
]  # fmt: skip

ORDERS = [
    ("head straight to the kitchen", "F kitchen"),
    ("go to the kitchen and the bedroom, in whichever order you like", "F kitchen & F bedroom"),
    ("go to either landmark one or the red room", 'F ("landmark one" | "red room")'),
    ("visit landmarks one, two and three",
     'F "landmark one" & F "landmark two" & F "landmark three"'),
    ("ok robot, um, go to the kitchen", "F kitchen"),
    ("robot, find a robot", "F robot"),
    ("find me the little robot and a drone, buddy", 'F "little robot" & F drone'),
]  # fmt: skip

AVOIDANCE = [
    ("do not under any circumstances enter the hallway", "G !hallway"),
    ("go through the red room to the third floor without entering landmark one",
     'F ("red room" & F "third floor") & G !"landmark one"'),
    ("go to the kitchen and then the bedroom, avoiding the hallway at all times",
     "F (kitchen & F bedroom) & G !hallway"),
    ("go to the kitchen through a room other than the hallway", "F kitchen & G !hallway"),
    ("use any door except the front door to get to the kitchen", 'F kitchen & G !"front door"'),
    ("only go through rooms that are not the hallway to get to the kitchen",
     "F kitchen & G !hallway"),
    ("do not pass the hallway when you go to the kitchen", "F kitchen & G !hallway"),
]  # fmt: skip

RULES = [
    ("visit the kitchen two or more times", "F (kitchen & F (!kitchen & F kitchen))"),
    ("the maximum number of visits to the kitchen is one",
     "!F (kitchen & F (!kitchen & F kitchen))"),
    ("after you ever see the cat, go to the door", "G (cat -> F door)"),
    ("always go to the door once you see a cat", "G (cat -> F door)"),
    ("visit the kitchen; the hallway may only be visited after the garden",
     "F kitchen & (!hallway W garden)"),
    ("avoid the park until you reach the bank, then go to the park", "F park & (!park W bank)"),
    ("go to the kitchen, but if you see a cat go to the door", "F kitchen & G (cat -> F door)"),
]  # fmt: skip

ASKED = [
    ("go through the kitchen and the hallway to the bedroom",
     ["F (kitchen & F (hallway & F bedroom))",
      "F (kitchen & F bedroom) & F (hallway & F bedroom)"]),
    ("go to the bedroom only through the hallway",
     ["F (hallway & F bedroom)", "F (hallway & F bedroom) & (!bedroom W hallway)"]),
    ("go to the kitchen, avoiding the hallway, and then to the bedroom",
     ["F (kitchen & F bedroom) & (!hallway W kitchen)", "F (kitchen & F bedroom) & G !hallway"]),
    ("go to the kitchen, then go to the hallway but do not go back to the kitchen",
     ["F (kitchen & F hallway) & (!kitchen W (kitchen W (!kitchen W hallway)))",
      "F (kitchen & F hallway) & !F (kitchen & F (!kitchen & F kitchen))"]),
]  # fmt: skip

REFUSED = [
    ("go to landmark 1 on the second floor", "landmark 1 on the second floor"),
    ("go to the coffee shop on main street", "coffee shop on main street"),
    ("when heading over to the sofa, avoid the bed", "when heading over to the sofa"),
    ("go to the green one", "one"),
    ("go to the red room, then to the other one", "other"),
    ("avoid all rooms but the kitchen", "but the kitchen"),
    ("go anywhere but the kitchen", "anywhere"),
    ("stay in the kitchen", "stay in the kitchen"),
    ("go to the kitchen if possible", "possible"),
    ("go to the kitchen unless it is closed", "closed"),
    ("go around the kitchen", "around the kitchen"),
    ("go to the kitchen, but not if it is dark", "dark"),
    ("go to the kitchen within five minutes", "within five minutes"),
    ("do not go to the kitchen yet", ""),
    ("almost reach the kitchen", "almost"),
    ("go to the kitchen alternately with the bedroom", "alternately"),
    ("go with the dog", "with the dog"),
    ("move from the bed", "from the bed"),
    ("mind the dog", "mind the dog"),
    ("always visit the kitchen", "always visit the kitchen"),
    ("visit the kitchen in the end, and visit the hallway", "visit the kitchen in the end"),
    ("go to the kitchen but the hallway", "the hallway"),
    ("go to the red and blue chair", "red"),
    ("do not go to the kitchen until you have visited the hallway twice",
     "until you have visited the hallway twice"),
    ("you must visit the kitchen right before the hallway", "before the hallway"),
    ("as soon as the cat is seen, visit the door in the next step", "as soon as the cat is seen"),
    ("go to the hallway after the kitchen, go to the kitchen after the garage",
     "go to the kitchen after the garage"),
    ("avoid the kitchen and enter the kitchen through the hallway", "enter the kitchen"),
    ("seeing the cat opens the door", "seeing the cat opens the door"),
    ("go to the red room room", "room"),
    ("go to the bed room", "room"),
    ("go to the kitchen after 5 minutes", "after 5 minutes"),
    ("go to the kitchen before it closes", "before it closes"),
    ("go to the kitchen with no stops", ""),
    ("go to the kitchen. no, go to the hallway", "no"),
    ("go to the sofa kitchen", "kitchen"),
    ("go to the hall through the park and the garden through the lobby", "through the lobby"),
    ("follow the dog", "follow the dog"),
    ("go to the kitchen and the hallway and stay there", "stay there"),
    ("never go to the kitchen through the hallway", "through the hallway"),
    ("go to the kitchen and the garden via the hallway", "via the hallway"),
    ("starting at the kitchen, avoid the hallway", "starting at the kitchen"),
    ("follow me to the kitchen", "me to the kitchen"),
    ("come with me to the kitchen", "me to the kitchen"),
    ("visit the kitchen as long as you have not visited the garage",
     "as long as you have not visited the garage"),
    ("take a walk to the sofa", "a walk to the sofa"),
    ("you may go anywhere but you finish at the sofa", "go anywhere but you finish at the sofa"),
    ("see the sofa zero times or more", "zero times or more"),
    ("turn back at the sofa", "back at the sofa"),
    ("visit the sofa in this order", "visit the sofa in this order"),
    ("either find the sofa", "either find the sofa"),
    ("fetch the sofa. go to the bed first", "first"),
    ("hit the sofa no more than once got it", "got it"),
    ("get to the sofa and take a picture", "take a picture"),
    ("never visit any place again", "never visit any place again"),
    ("visit the sofa and the bed, without visiting any other place",
     "without visiting any other place"),
    ("visit the sofa and leave it", "leave it"),
    ("the robot is in the house, have it go to the sofa", "in the house"),
    ("clean the sofa or the bed but not both", ""),
    ("the hall has just been mopped so keep out of it and go to the bed",
     "the hall has just been mopped"),
    ("would you be a dear", ""),
    ("get to the theater via the bridge or via the park", "via the park"),
    ("visit the sofa, then visit the bed in the next step", "in the next step"),
    ("go to the sofa or go to the desk on the way to the bed", "on the way to the bed"),
    ("go to the sofa when you reach the bed visit the oven", "when you reach the bed"),
    ("go to the kitchen and the sofa. pass the hallway on the way", "pass the hallway on the way"),
    ("go to the sofa and leave the bed", "leave the bed"),
    ("visit and leave the sofa", "leave the sofa"),
    ("visit the sofa, leave it and repeat this once", "repeat this once"),
    ("visit the sofa twice, then the bed, no revisiting", "no revisiting"),
]  # fmt: skip

COMPOSED = [  # misreadings found with the sentences of the small translator's composer
    ("stop by the sofa. afterwards be careful not to see the bed", "F sofa & G (sofa -> G !bed)"),
    ("only explore the sofa one single time", "F sofa & !F (sofa & F (!sofa & F sofa))"),
    ("you should end up at landmark two after visiting landmark one",
     'F ("landmark one" & F "landmark two")'),
    ("you can not proceed to the sofa more than once, and first turn on the bed, then the oven",
     "F (bed & F oven) & !F (sofa & F (!sofa & F sofa))"),
    ("visit the sofa and proceed to use the bed", "F (sofa & F bed)"),
    ("you must examine the sofa directly after you scan the bed", "G (bed -> X sofa)"),
]  # fmt: skip


SAID_OTHERWISE = [  # sentences of people that the examples lacked
    ("Drone, find landmark 2", 'F "landmark two"'),
    ("I want you in the kitchen, but the sofa is off limits", "F kitchen & G !sofa"),
    ("go to the kitchen; the robot is forbidden from the hallway", "F kitchen & G !hallway"),
    ("go to the kitchen, and don't ever go on the second floor", 'F kitchen & G !"second floor"'),
    ("do not visit the sofa. do not visit the bed either", "G !sofa & G !bed"),
    ("visit the sofa, the hallway is forbidden please", "F sofa & G !hallway"),
    ("visit the sofa, then the bed, while always avoiding the desk", "F (sofa & F bed) & G !desk"),
    ("as soon as you reach the sofa, do not visit the bed", "G (sofa -> G !bed)"),
    ("visit the door, then the window, all without visiting the bed",
     "F (door & F window) & G !bed"),
    # orders
    ("your first stop is the sofa, your second stop is the bed and your last stop is the desk",
     "F (sofa & F (bed & F desk))"),
    ("visit the sofa, then the bed. pass the hallway on the way",
     "F (sofa & F (hallway & F bed))"),
    ("the bed is where you finish, but go to the sofa before that", "F (sofa & F bed)"),
    ("reach the sofa and do not go to the bed afterwards please", "F sofa & G (sofa -> G !bed)"),
    ("look at the sofa, and later on at the bed", "F (sofa & F bed)"),
    ("please visit in this order: the sofa, the bed, the desk", "F (sofa & F (bed & F desk))"),
    ("u must go to the sofa", "F sofa"),
    ("go to the school through the park and then through the bank",
     "F (park & F (bank & F school))"),
    ("can you go to the bank? but you'd have to go by the park first", "F (park & F bank)"),
    ("whenever the robot visits the bed it must visit the sofa", "G (bed -> F sofa)"),
    ("each trip to the bed must be followed by a visit to the window", "G (bed -> F window)"),
    # any order, any of them
    ("go to the bank or the park, any one", "F (bank | park)"),
    ("on your trip, visit all of these: the sofa, the bed", "F sofa & F bed"),
    ("never go to the sofa before you go to the bed, but do go to both",
     "F sofa & F bed & !sofa W bed"),
    ("the car should go to the bank", "F bank"),
    ("anytime you are in the hall you should then go to the bed", "G (hall -> F bed)"),
    ("get to at least one of these: the sofa, the bed, the desk", "F (sofa | bed | desk)"),
    ("get to at least one of the following: the sofa, the bed", "F (sofa | bed)"),
    ("the sofa and the bed both have to be visited", "F sofa & F bed"),
    # whenever
    ("see the sofa if you have seen the bed then you may go to the oven", "F sofa"),
    # verbs
]  # fmt: skip

ASKED_ABOUT = [
    ("reach the bed, going via the hallway and then the sofa",
     ["F (hallway & F (bed & F sofa))", "F (hallway & F (sofa & F bed))"]),
]  # fmt: skip


_IN_TURN = "F (sofa & F (bed & F desk)) & !bed W sofa & !desk W bed"
_ONCE_EACH = f"{_IN_TURN} & !sofa W sofa W !sofa W bed & !bed W bed W !bed W desk"
ALL_OF_THEM = [  # phrases about all targets
    ("visit the sofa and the bed, each only once",
     "F sofa & F bed & !F (sofa & F (!sofa & F sofa)) & !F (bed & F (!bed & F bed))"),
    ("visit the sofa, then the bed. never visit them again",
     "F (sofa & F bed) & !F (sofa & F (!sofa & F sofa)) & !F (bed & F (!bed & F bed))"),
    # In a sequence, until the next step; and none of them out of turn.
    *((f"visit the sofa, then the bed, then the desk{how}", _ONCE_EACH) for how in (
        ". visit each place only once", " without repetitions",
        ". never return to any previously visited place", ", without going back",
        ", while visiting each location once", ". visit each of them only once",
        ". you can only visit each landmark once",
    )),
    ("visit the sofa, the bed and the desk exactly once in order", _ONCE_EACH),
    ("visit the sofa, the bed and the desk in order without skipping or revisiting any of them",
     _ONCE_EACH),
    *((f"visit the sofa, then the bed, then the desk{how}", _IN_TURN) for how in (
        " in exactly that order", ", make sure not to visit places out of turn",
        ". do not visit any place out of order",
    )),
    ("do not go to the desk until you visited the bed, and do not go to the bed before the sofa",
     _IN_TURN),
]  # fmt: skip

LEAVING = [  # which separate visits do anyway
]  # fmt: skip


NO_LONGER_READ = [  # too rare to keep their rules: they are refused, not misread
    "visit the sofa, then the bed, then the desk. do not go back to the previous place "
    "while heading to the next",
    "visit the sofa, then the bed, then the desk, each only once",
    "visit the sofa, then the bed, then the desk, no revisiting",
    "go to the kitchen and stay there",
    "go to the kitchen and then the bedroom and stay there",
    "go to the kitchen and stop there",
    "go to the kitchen and remain there",
    "enter the red or blue room",
    "go to the red and the blue room",
    "go to the red, blue and green rooms",
    "go to the third or the fourth floor",
    "go to the first or second floor",
    "go to floors 1 and 2",
    "go around the hallway to get to the kitchen",
    "go to the kitchen by going around the hallway",
    "go through any room but the hallway to get to the kitchen",
    "visit the kitchen twice, no more no less",
    "enter the bedroom from the hallway",
    "from the kitchen go to the bedroom",
    "starting from the kitchen, go to the bedroom",
    "start in the kitchen and end in the bedroom",
    "start on the first floor and go to the third floor",
    "open the sofa, swing by the bed, head to the oven one by one in this order",
    "in this order, open the sofa, swing by the bed",
    "go to the sofa stopping by the bed",
    "go to the theater; only after the bank though",
    "the hallway, the sofa, the bed. In that order please",
    "the sofa comes first, then the bed",
    "visit the sofa; next up is the bed; the desk comes last",
    "go to the bed, would you?",
    "go to the bank, then back to the park, then once more to the bank",
    "go to the bank and right after that to the park",
    "go twice to the kitchen",
    "neither the bank nor the park may ever be visited",
    "make the sofa your destination",
    "go to the bed, and each time you pass the desk, go to the window after it",
    "visit the sofa and the bed exactly once each",
    "go to the sofa, leave it and come back",
    "go to the sofa, leave, then go to the sofa once again",
    "go to the sofa, then leave it, then go to the bed",
    "go to the sofa and then leave the sofa at least twice",
    "visit and then leave the sofa at least twice",
    "visit the sofa at least twice while leaving in between",
    "visit the sofa, leave it and never come back",
    "visit the sofa, leave it and repeat this exactly once more",
    "visit the sofa, then leave and repeat this at least two more times",
    "turn the tv off",
    "go to the bed; until then do not go to the tv",
    "Do not go to the bed or touch the tv. Go to the sofa.",
    "travel from a to b to c",
    "visit the bed and the sofa or the tv",
    "visit the bed or the sofa and the tv",
    "go from the door to the bed through the hallway",
    "don't go to the kitchen or go to the bedroom",
    "Go to the kitchen and the bedroom. The kitchen comes last.",
    "Go to the kitchen and the bedroom, avoiding the hallway. The kitchen comes last.",
]


def formulas_of(sentence: str) -> tuple[Formula, ...]:
    return distinct(readings(sentence))[0]


PLAIN = [
    *THROUGH, *SEQUENCES, *ORDERS, *AVOIDANCE, *RULES, *COMPOSED, *ALL_OF_THEM, *LEAVING,
    *SAID_OTHERWISE,
]  # fmt: skip
MEANT = [*((said, [formula]) for said, formula in PLAIN), *ASKED, *ASKED_ABOUT]


@pytest.mark.parametrize(("sentence", "formulas"), MEANT)
def test_means(sentence: str, formulas: list[str]) -> None:
    for one, expected in zip(formulas_of(sentence), formulas, strict=True):
        assert distinguishing_trace(one, parse(expected)) is None, f"{one} is not {expected}"


@pytest.mark.parametrize(("sentence", "part"), REFUSED)
def test_refuses(sentence: str, part: str) -> None:
    with pytest.raises(TranslationError) as refusal:
        formulas_of(sentence)
    assert part in refusal.value.part


@pytest.mark.parametrize("sentence", NO_LONGER_READ)
def test_rare_phrasings_are_refused(sentence: str) -> None:
    with pytest.raises(TranslationError):
        readings(sentence)
