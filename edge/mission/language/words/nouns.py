"""The words that a name in an instruction may have, and suggestions for typing errors.

Only known words are allowed, so that a typing error never becomes a target.

Known words are in the alias table (`edge.names`) and the lists here. Other names need double
quotes.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence
from functools import lru_cache

from edge import names, number_words

# Nouns and other words, by kind; "|" stands for a space within an entry.
_PLACES = """
    apartment attic balcony basement bathroom bedroom cellar classroom conservatory corridor
    courtyard cubicle den driveway elevator entrance entry exit fence floor foyer garage garden gate
    gym hall hallway house kitchen laundry lawn lift living|room dining|room meeting|room
    conference|room waiting|room guest|room storage|room library lobby lounge lab laboratory
    landmark nursery office pantry patio path pavement playroom pool porch reception restroom road
    roof room shed shop sidewalk stair stairs staircase station storeroom street studio study
    terrace aisle bay ward suite sector lane terminal cell block slot level storey kitchenette
    washroom canteen stockroom mailroom cloakroom ballroom boardroom darkroom showroom staffroom
    lunchroom guestroom stairwell sunroom mezzanine sluice loft carport parlor parlour workroom
    hideout toilet|room wall waypoint wc workshop yard zone area region airport bakery bank bar
    bridge building bus|stop cafe car|park castle cathedral cemetery church cinema college court
    crossing crosswalk cafeteria clinic embassy farm field fountain forest hospital hotel inn
    junction lake mall market memorial monument museum park parking|lot parking|space pharmacy pier
    platform playground plaza post|office pub restaurant river school square stadium store
    supermarket temple theater theatre tower town|hall train|station tunnel university warehouse zoo
    passage passageway doorway archway
"""
_OBJECTS = """
    apple aquarium ashtray bag baggage banana banner barbecue barrel basket bat battery beam bedside
    bell bin bird blanket blender blind board boat book booth broom brush bucket bus button cable
    cage cake calendar camera can candlestick canoe cap carrot cart case cat ceiling chandelier
    chest chopping|board coat coat|rack coffee coin column computer cone container cooler cot couch
    cow crate crib cushion cupboard desktop dice dish dog doll doormat drawer dress drill drone drum
    dryer duck extinguisher fire|extinguisher fan faucet figure file filing|cabinet fireplace flag
    flashlight flower footstool fork forklift frame fruit frying|pan furnace game giraffe glass
    glasses glove goat grill guitar hair|dryer hammer handbag hanger hat headphone heater helmet
    horse hose hydrant fire|hydrant ipad iron ironing|board jacket jar jug kettle key keys kite
    knife ladder lamp|post laptop lever lighter lightswitch lock locker machine magazine mailbox mat
    mattress microwave mop motorcycle motorbike mouse nail newspaper notebook orange oven paint
    pallet pan panel paper parcel package pen pencil pet phone|booth pillar pipe pizza plant plunger
    pole pot potato purse puzzle rabbit rack racket radiator radio rail refrigerator ring robot rock
    rope router rug safe salt sandwich saw scale scissors scooter screen screwdriver sculpture seat
    sheep shirt shoe sign stop|sign skateboard skis snowboard soap sock speaker spoon sponge stapler
    statue stick stone sunglasses surfboard swing switch tank tap tape tent tie tissue toolbox tool
    toothbrush toy tractor traffic|light trailer train tray tree tricycle trolley truck typewriter
    vehicle van vent vending|machine violin walker wallet watch water|cooler water|dispenser
    whiteboard blackboard wheel wheelchair wine wire workbench zebra elephant bear till
    charging|station charger dock docking|station loading|dock
"""
_EVERYDAY = """
    alarm album ambulance anvil apron armrest axe backpack badge bagpipe balance|bike ball balloon
    bandage barbell barcode|scanner barrier barrow bath bathrobe battery|pack beach|ball beach|towel
    beaker beanbag bedpan bedsheet bedspread bed|rail bed|table beer beetle belt bib bicycle binder
    binoculars birdcage bird|cage biscuit blazer bleach blocks blood|pressure|cuff
    blood|pressure|monitor blouse bolt bonnet bookmark boot boots bouncy|ball bouquet bowtie box
    boxes bracelet bread briefcase broccoli brooch bubble|wrap building|blocks bulb bulletin|board
    bumper bunk|bed burger butter cabbage cable|drum cable|reel cactus calculator candy cape
    cardboard cardigan card|box carpet cart|wheel casserole cassette catheter cat|bowl cat|tree
    caution|sign cereal chain chainsaw chalk chalkboard charger|cable cheese cherry chess|board
    chopper chopsticks cigarette clamp clarinet cleaning|cart cleaver clip clipboard cloth clothes
    clothesline clothes|hanger coaster cockpit coffin coil colander coloring|book comb comforter
    commode compass compressor console conveyor conveyor|belt cookbook cookie cookie|jar cooking|pot
    copier cord cork corkscrew cork|board costume crackers cradle crane crash|cart crayon crayons
    cream crowbar crown crutch crutches cube cucumber cufflink curler curtain|rail cutlery cutter
    cutting|board darts deck|chair defibrillator dentures deodorant detergent diaper diaper|bag
    dinosaur dispenser dog|bed dog|bowl dog|leash dollhouse dolly doll|house donut dough dragon
    dressing|gown drip|stand dumpster dump|truck duster dustpan duvet earphone earphones earring
    earrings easel ecg|machine egg egg|timer ekg|machine envelope epipen eraser espresso
    examination|table exam|table extension|cord eyeglasses eyewash|station face|mask fanny feather
    feeder filing|tray fire|alarm fire|engine fire|truck first|aid|kit fish fishbowl fishing|rod
    flask flipper flippers flip|chart flour flowerpot flute foil folder food food|cart football
    footrest forceps forklift|truck frisbee frog fryer funnel fuse|box gamepad gauge gauze generator
    giftbox glove|box glue gloves glue|stick goggles golf|ball golf|club gown grater gravy groceries
    grocery|bag gurney hairbrush hairpin ham hammock hamster handcart handkerchief handrail
    hand|cart hand|sanitiser hand|sanitizer hand|truck hard|hat harness harp headband headphones
    headset hearing|aid hearing|aids heart|monitor hedgehog helicopter highchair hole|punch hoodie
    hook hoover hospital|bed hot|water|bottle hula|hoop hydraulic|jack icepack ice|cream incubator
    infusion infusion|pump inhaler ink insulin intercom iv|pole iv|stand jackhammer jam jeans
    jerrycan jersey jewel jigsaw joystick juice jumper jumping|rope jump|rope kayak keg ketchup
    keychain keyring kit kitten kitty|litter knapsack knitting knitting|basket knob label
    label|printer label|roll lace lampshade lantern laser laundry|basket laundry|cart leash lego
    legos lego|box lemon life|jacket lift|truck lightbulb light|bulb linen linen|bag linen|cart lint
    lion|toy lipstick litter|box litter|tray loaf loudspeaker lunchbox lunch|bag lunch|box
    magic|wand magnet magnifier magnifying|glass mallet mannequin map marker mask matches meal|cart
    measuring|tape medication medication|cart medicine medicine|cabinet medicine|cart med|cart
    megaphone menu microphone microscope milk mitten mittens mixer mobile mobility|scooter money
    monkey moped mousepad mousetrap muffin multimeter napkin napkins nebulizer necklace needle net
    newspaper|rack nightgown notepad nozzle nut nutcracker oar oil oil|can ointment onion
    overbed|table oxygen oxygen|bottle oxygen|tank pacifier packet packing|station packing|tape pads
    pail paintbrush pajamas pallet|jack pallet|rack pallet|truck palm pamphlet pancake pants
    paperback paperclip papers paper|airplane paper|clip paper|plane paper|towel parasol parrot
    passport pasta paste patient|lift peach peanut pear pedal peg pegboard pencil|case
    pencil|sharpener pendant penguin pepper perfume pet|bed photo photocopier photo|album pickaxe
    picnic|basket picture|book pie piggy|bank pill pillbox pillowcase pills pill|box pin pincushion
    pineapple pirate|hat pirate|ship pitcher pitchfork placemat plaster plasters plate|rack playpen
    pliers plug plum pocketknife poker police|car polish popcorn postcard poster potty powder
    power|drill power|strip pram prescription present presents pressure|cooker princess|dress
    printer|paper projector prop pulley pulse|oximeter pump puncher puppet puppy purifier pushchair
    puzzle|box puzzle|piece pyjamas quilt race|car racquet radio|set raft raincoat rake ramp
    raspberry rattle razor reach|truck reading|glasses reading|lamp receipt reception|desk
    record|player recycling|bin reel remote|control ribbon rifle robe rocket rocking|chair
    rocking|horse roller
    roller|skates rolling|pin rubber|duck ruler sack saddle safety|cone safety|glasses safety|helmet
    safety|vest safe|box salad sandal sandals sandbox sandpaper satchel sauce saucepan saucer
    sausage saxophone scalpel scanner scarf schoolbag school|bag scoop scratching|post scrubber
    seesaw sewing|machine shampoo shark|toy sharps|bin sharps|container shaver shawl shears shield
    shin shipping|box shoes shopping|bag shopping|basket shopping|cart shopping|trolley shorts
    shovel shower|chair shower|curtain shower|head shrink|wrap sieve silverware skate skates
    skipping|rope skirt sled sledge sleeping|bag slide sling slipper slippers smoke|alarm
    smoke|detector snack snake snorkel snowman snow|globe soccer|ball socket socks soda
    soldering|iron spade sparkler spatula spectacles sphygmomanometer spice|rack spider spill
    spill|kit spinner spool spray spray|bottle spring sprinkler squeegee squirrel stack stamp
    stencil stepladder step|ladder step|stool stereo stethoscope sticker stickers stickman stocking
    stockings stopwatch storage|box storybook story|book strainer strap strapping|machine straw
    strawberry stretcher stretch|wrap string stroller stuffed|animal suction|machine sugar
    sugar|bowl suit sunhat sunscreen sweater sweatshirt swimsuit sword syringe syringes syrup
    t-shirt tablecloth tablet tablets tambourine tape|dispenser tape|gun tape|measure tarp tea
    teabag teacup teapot tea|cup tea|kettle tea|towel telescope tennis|ball tennis|racket
    thermometer thermos thermostat thimble tiara ticket tie|rack tiger|toy tights timer tin tire
    tissues tissue|box toaster|oven toilet|brush toilet|paper tomato tongs toolkit tool|box tool|kit
    toothpaste toothpick torch toys toy|box toy|car toy|kitchen toy|robot toy|train toy|truck
    track|suit traffic|cone trampoline tray|table tripod trolley|cart trophy trousers trowel trumpet
    tshirt tuba tube tumbler turntable turtle tuxedo tv|remote tweezers type|writer ukulele
    ultrasound ultrasound|machine uniform urinal usb|stick ventilator vest videotape vinegar vise
    vital|signs|monitor waffle wagon walkie|talkie walking|aid walking|frame walking|stick washcloth
    washing|basket washing|line waste|paper watering|can watering|pot watermelon water|bottle
    water|jug wax weight weights wellies wet|floor|sign wheelbarrow whisk whistle wig windchime
    wind|chime wiper wok wool wreath wrench x-ray|machine xylophone yarn yo-yo yoga|mat yogurt
    zipper
"""
_PEOPLE = """
    mom mum mother dad father baby boy girl guest guard nurse doctor patient worker customer visitor
    grandma grandpa kid neighbor neighbour sister brother
"""
_MATERIALS = """
    wood wooden metal metallic plastic glass leather stone brick concrete steel iron marble wicker
    bamboo paper cotton velvet fabric ceramic rubber
"""
_COLOURS = """
    red green blue yellow orange purple violet pink brown black white gray grey beige golden silver
    cyan magenta turquoise maroon navy tan crimson scarlet olive lime
"""
_QUALITIES = """
    colored coloured dark light bright pale large big huge small little tiny mini tall high short
    low long wide broad narrow slim thin thick round square rectangular oval circular flat curved
    striped checkered old new modern antique vintage broken dirty empty full open closed double
    single soft hard heavy folding rocking sliding electric digital front back rear left right main
    upper lower top bottom middle central inner outer north south east west northern southern
    eastern western potted ground parked
"""
_PLAIN = """
    left right straight forward forwards backwards ahead sideways together apart halfway help want
    wish hope think know tell say ask give put set let try hold carry lift push pull throw drop sing
    dance sleep eat drink cook guard fix build feel deliver hand hang complete continue separated
    separate exceed prevents happen hour hours minute minutes second seconds moment day days week
    night noon midnight morning evening afternoon o'clock oclock pm am time times dinner lunch
    breakfast whether while since as so such other others another same different few several many
    much enough half quarter often util side end middle edge kind sort type reason idea question
    answer order turn turns response predecessor successor former latter remaining nice good bad
    great fine free ready done able sure careful safely metre metres meter meters feet home halt
    possible keep stray straying stick sticking protect defend forget miss spin wander bring spend
    hurry
"""


def split_entries(text: str) -> frozenset[str]:
    """Return the entries of a text; "|" stands for a space within an entry."""
    return frozenset(entry.replace("|", " ") for entry in text.split())


_FOREIGN = split_entries(
    """
    und oder der das dem den ein eine zum zur dann nicht geh gehe gehen fahr fahre nach bitte
    danach vermeide besuche erst le la les au aux du et puis va vas allez ne pas avant ensuite
    evite el los las y luego despues ve vaya hacia una al il lo gli e poi vai alla naar het een
    dan ga niet
    """
)
"""Short words of other languages that never occur in English sentences."""
PEOPLE = split_entries(_PEOPLE) | {"person"}
"""Nouns for people."""
NOUNS = (
    split_entries(_PLACES)
    | split_entries(_OBJECTS)
    | split_entries(_EVERYDAY)
    | split_entries(_PEOPLE)
)
"""All nouns of the lists; the alias table of `edge.names` has more."""
COLOURS = split_entries(_COLOURS)
QUALITIES = COLOURS | split_entries(_QUALITIES) | split_entries(_MATERIALS)
"""Words that may precede a noun in a name: "red", "wooden"."""
PLAIN_WORDS = split_entries(_PLAIN) - NOUNS
"""Words that name no object, so a refusal must not suggest them as one."""
NUMBERED = split_entries(
    """floor level storey story landmark room door waypoint gate street aisle bay dock lane terminal
    ward"""
)
"""Kinds with numbered members: "second floor" is no second step."""
# Rooms; two of them in a row are two names.
ROOMS = split_entries(
    """apartment attic balcony basement bathroom bedroom cellar classroom conservatory corridor
    garage garden hall hallway kitchen laundry library lobby lounge nursery office pantry patio
    restroom terrace gym"""
)
NUMERALS = (*number_words.ORDINALS, "last")
"""Ordinal numbers in order, and "last"."""
ORDINALS = frozenset(NUMERALS)
"""The same as a set."""
_NAMED_BY_CONTENT = split_entries("shop store station stop room market museum lot stand park")
"""Places that are named after their content: "coffee shop", "printer room"."""
# Further objects that lead to a place.
_WAYS = ("door", "ladder", "ramp", "escalator", "way", "passage", "doorway")
_LONGEST = 6
"""Largest number of words of a known noun."""
_LEADING = split_entries(_PLACES)  # places that may precede a noun: "kitchen sink", "office door"


@lru_cache(maxsize=4096)
def is_noun(phrase: str) -> bool:
    """Return True if a phrase names a kind of object, in the singular or plural."""
    return names.is_known(phrase) or phrase in NOUNS or names.singular(phrase) in NOUNS


def is_plural(word: str) -> bool:
    """Return True if a word is the plural of a noun, and not itself in a list like "glasses"."""
    singular = names.singular(word)
    return singular != word and is_noun(singular) and not (word in NOUNS or names.is_alias(word))


def is_place(name: str) -> bool:
    """Return True if a name is the name of a place, or of something that leads to one."""
    return name.split()[-1] in _LEADING or name in _LEADING or name.split()[-1] in _WAYS


def unknown_in(words: list[str]) -> int | None:
    """Return the index of the first word that cannot be part of a name; None if all form a name.

    A name has qualities, then a noun. A place ("kitchen sink"), an owner ("mom's bed") or an
    ordinal ("first floor") may precede the noun. A number or a letter may follow it ("landmark
    two").
    """
    begin, end = 0, len(words)  # without the number at the end
    if end > 2 and number_words.number(words[-2:]) is not None:
        end -= 2
    elif end > 1 and (number_words.number(words[-1:]) is not None or _MARK.fullmatch(words[-1])):
        end -= 1
    # The longest noun at the end begins at `start`.
    start = next((i for i in range(end) if is_noun(" ".join(words[i:end]))), None)
    if start is None:
        return _find_wrong_word(words, end)
    # "bed bed"
    twice = next((i for i in range(1, end) if words[i] == words[i - 1]), None)
    if twice is not None:
        return twice
    if words[start] in ("path", "way") and start and is_noun(words[start - 1]):
        return start  # "the red room path": the room, or a path?
    if start and words[start] in _NAMED_BY_CONTENT and _is_compound(*words[start - 1 : start + 1]):
        start -= 1  # "coffee shop"
    while begin < start:  # the words before the noun; `after_place` follows a place among them
        word = words[begin]
        after_place = next(
            (i for i in range(start, begin, -1) if " ".join(words[begin:i]) in _LEADING), None
        )
        if after_place is not None:
            if words[after_place - 1] in ROOMS and words[end - 1] in ROOMS:
                return after_place  # "kitchen bedroom": two rooms in a row
            begin = after_place
        elif word in ORDINALS and begin and words[begin - 1] in _LEADING:
            return begin  # "first floor third floor"
        elif word in QUALITIES or _is_ordinal(word) or _is_owner(word):
            begin += 1
        else:
            return start if is_noun(word) else begin
    return None


def _is_compound(first: str, second: str) -> bool:
    """Return True for `coffee shop`, but not for `bed room`, which is a slip of one word."""
    return is_noun(first) and not is_noun(first + second)


def _find_wrong_word(words: list[str], end: int) -> int:
    """Return the index of the wrong word in a name without a known noun at its end.

    It is the word after a known noun, or the first unknown word.
    """
    for last in range(end - 1, 0, -1):
        # The name `words[i:last]` is known, so the word after it is wrong.
        # Limit the search: with thousands of unknown words it would take seconds.
        if any(is_noun(" ".join(words[i:last])) for i in range(max(0, last - _LONGEST), last)):
            return last
    odd = (i for i in range(end) if words[i] not in QUALITIES and words[i] not in ORDINALS)
    return next(odd, 0)


def _is_ordinal(word: str) -> bool:
    return word in ORDINALS or number_words.ordinal(word) is not None


def _is_owner(word: str) -> bool:
    return word.endswith("'s") and is_noun(word[:-2])


# "b", "12", "b12", "3a"
_MARK = re.compile(r"[^\W\d_]|[a-z]?\d+[a-z]?")


@lru_cache(maxsize=1)
def _all_words() -> tuple[str, ...]:
    others = (alias for aliases in names.ALIASES.values() for alias in aliases)
    phrases = (*names.ALIASES, *others, *NOUNS, *QUALITIES)
    return tuple(dict.fromkeys(word for phrase in phrases for word in phrase.split()))


def suggest_word(word: str) -> str | None:
    """Return the known word of which a word is most likely a typing error; None if there is none.

    The caller only suggests this word to the user, and never uses it by itself.

    >>> suggest_word("firdge"), suggest_word("blorf"), suggest_word("whether")
    ('fridge', None, None)
    """
    if len(word) < 4 or len(word) > 30 or is_word(word):
        return None
    return slip_of(word, _all_words())


def is_word(word: str) -> bool:
    """Return True if a word is known, also as a word of no name; then it is no typing error."""
    return word in PLAIN_WORDS or word in QUALITIES or is_noun(word)


_SHORT, _LONG = 5, 8  # letters; two slips are allowed from `_LONG` on


def slip_of(word: str, known: Sequence[str]) -> str | None:
    """Return the known word of which this one is a typing error, or None.

    A slip keeps the first letter and adds, drops, changes or swaps one letter (two in a long word).
    A short word with other letters is another word.

    >>> slip_of("vist", ["visit"]), slip_of("base", ["basket"]), slip_of("home", ["some"])
    ('visit', None, None)
    """
    most = 2 if len(word) >= _LONG else 1
    close = difflib.get_close_matches(word, known, n=5, cutoff=0.7)
    slips = [other for other in close if other != word and other[0] == word[0]]
    if len(word) < _SHORT:  # a letter may be missing, added or swapped, but not another one
        slips = [s for s in slips if len(s) != len(word) or sorted(s) == sorted(word)]
    return next((slip for slip in slips if _edit_distance(word, slip) <= most), None)


def _edit_distance(a: str, b: str) -> int:
    """Return the edit distance: letters to add, drop, change, or swap with the next one."""
    # Row i of the usual table: distances of a[:i] to each b[:j]; `before` and `older` are the last
    # two rows.
    before, row = [], list(range(len(b) + 1))
    for i, x in enumerate(a, 1):
        older, before, row = before, row, [i]
        for j, y in enumerate(b, 1):
            best = min(before[j] + 1, row[-1] + 1, before[j - 1] + (x != y))
            if i > 1 and j > 1 and (x, a[i - 2]) == (b[j - 2], y):
                best = min(best, older[j - 2] + 1)
            row.append(best)
    return row[-1]


def is_foreign(text: str) -> bool:
    """Return True if a text is clearly not English: another script, or words of another language.

    >>> is_foreign("Geh zum Sofa und dann zum Bett."), is_foreign("go to the sofa")
    (True, False)
    """
    letters = [c for c in text if c.isalpha()]
    if letters and sum(ord(c) > 0x24F for c in letters) * 2 > len(letters):
        return True
    words = "".join(c if c.isalpha() else " " for c in text.lower()).split()
    small = sum(word in _FOREIGN for word in words)
    return small >= 2 and small * 4 >= len(words)
