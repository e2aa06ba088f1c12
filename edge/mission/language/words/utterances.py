"""Templates of utterances that are no errand: questions, orders to learn, control, remarks.

The module `intents` classifies utterances with them. For the notation see `templates`.
"""

from __future__ import annotations

# Name → template, for `{name}` in another template.
PARTS = {
    # Questions.
    "anything": "([(is|was) there|(did|do) you see] (anything|something) [else])",
    "so_far": """
        [(are|is) there|there (are|is)|(do|did) you [already] (know|see|find|remember|have)|
        you [already] (know|see|saw|found|remember|have|visited|saved)|have you [already|ever|
        been]* [seen|found|visited|mapped|explored|learned|learnt|saved|stored|been|been to|been in|
        got]|have (i|we) [already] (taught|shown|told) you|(i|we) [have] (taught|showed|told) you|
        [does|do] (this|the|our|we|it) [flat|house|home|apartment|building|place|floor] (has|have)|
        of|about|in|in all|to|here|in here|so far|already|now|by now|until now|up to now|yet|
        in (this|the|our) (flat|house|home|apartment|building|place)|on (this|the|your) (floor|map|
        list)|in your memory|by heart]*
        """,
    "last": """
        [last|before|lately|recently|anywhere|somewhere|around|about|here|earlier|today|right now|
        at the moment|now|kept|located|exactly|at|gone|hiding|so far|already|lying|standing|yet|
        by now|by any chance|at all|again|on your (map|way|tour|rounds|trip)|in your memory|
        this (morning|afternoon|evening)|yes or no|where (you [last] (saw|seen|left|found|put) (it|
        them)|(it|they) (was|were) [before|last]*)|or (not|(did|has|have) ...)|(when|while|
        as) you [last] (were|was|drove|went|looked|came|passed|checked) ...|[the] last [time|
        when] you (saw|seen|noticed|spotted|passed) (it|them|her|him|one)|(got|gone|run off) to|
        ended up|[do] you (know|remember)|have you]* [(did|have) you [seen|see] (it|them|her|him|
        one)]
        """,
    "seen": """
        (see|seen|saw|spot|spotted|find|found|notice|noticed|come across|came across|remember|put|
        leave|left|discover|discovered|pass|passed|meet|met|clock|clocked|(run|ran|come|came|bump|
        bumped) (across|into))
        """,
    "you": "[did|have|had|has|do] (you|the robot|anyone|anybody) "
           "[have|had|did|ever|already|just|last|recently|by [any] chance|maybe|happen to]*",
    "tell": """
        [(when|while|as) you (came|went|were|drove|passed|looked|got|walked) [past|by|through|
        around|about|there|in there|out|last|earlier|this way|over there|the (place|
        house)]*] [can you|could you] [please] (explain [me|to me]|i [do] wish i knew|tell me|
        say [me]|know|show me|do you [still] (know|remember)|you know|[i wonder|any idea|
        i want to know|remind me|you remember|i was wondering|[do|would] [you] [would] [not] happen
        to (know|remember|recall)|have you any idea])
        """,
    "now": "[now|right now|at|exactly|at the moment|currently|just now|at present|today|then]*",
    "in": "[anywhere|somewhere|still|left|at all]* [on your (map|way|tour|rounds|trip)|"
          "in your memory|"
          "<relation> <anchor> [in <within>]]",
    # Orders to learn.
    "here": """
        ((the|this|this here) (spot|place|position|location|point|corner|area|aisle|bay)|this|here|
        where (you|we) are [standing|now]*|what you are [standing] in|your (position|location|place|
        spot)) [here|now|right here|where you are|you are at|you are in]*
        """,
    "this_room": "(this|the) room [here|you are in|where you are|we are in]",
    "keep": "(remember|log|save|store|note|mark|call|name|learn|label|register|memorize|memorise|"
            "set|keep in mind|know) [that|down]",
    "go": """
        [to|even|also] (use|access|go|going|went|drive|driving|enter|entering|come|coming|move|
        moving|step|roll|wander|get|getting|be|run|back|inside|into|in) [never|ever|back] [in|into|
        inside|to|over|near|at|on|through]*
        """,
    "away": """
        (stay|staying|keep|keeping|remain|steer) [well|far|always|right] (out|away|off|clear|
        outside)
        """,
    "may": """
        [again|now|and|so|okay]* [you|robot|the robot] (may|can|could|are allowed [to]|are free to|
        are welcome to|have permission to) [again|now|also|then|to]*
        """,
    "not": """
        [you|robot|robots|the robot] (do not [you dare|you|ever|dare]|never [ever]|(must|may|can|
        should|shall|will) not|not [may|can|should]|(are|have) (not|never [ever]) (allowed|supposed|
        permitted|welcome)|are (forbidden|banned) [from]|no [more]|it is (forbidden|prohibited|
        not allowed|not permitted) [for you|that you]|forbidden|(i|we) (do not want|
        will not have) you|(i|we) would (rather|prefer) [that] you (did not|do not|not|
        never)) [allowed|supposed|permitted|welcome]* [to|anymore|ever]*
        """,
    "while": """
        [, [and|so] (not ever|for (now|today|me|us|good|ever|always)|(it|starting|from) today|
        if you do not mind|at all costs|from now on|anymore|any more|again|ever|at all|now|always|
        today|at the moment|no matter what|any longer|okay|alone|under any circumstances|
        until (further notice|tomorrow|tonight|later)|forever [and ever]|[until|while|because|since|
        as|as long as] (i|we|he|she|they|it|there|people|someone|somebody|my (mother|father|husband|
        wife|baby|son|daughter|friend)|(the|a) (baby|patient|kid|kids|children|cleaner|doctor|floor|
        dog|cat)) [am|is|are|was|were|have|has|will|do|did|can|say|tell|come|get|let|call|moved|
        tore|finish|finished|need|do not|just|no longer] ...)]*
        """,
    # Control.
    "there": "[please|right|there|here|now|just|it|still|a bit|for me|for now|at once|immediately|"
             "moving|driving|hold on|hold it|wait|stop|"
             "everything|all|[no] i said (stop|wait)|like a statue|"
             "where you are|what you are doing|the robot|robot|okay]*",
    "halt": "(stop|halt|freeze|hold|pause|[do] not (move|continue|go on|drive on) "
            "[again|anymore|any more|a muscle])",
    "task": "[everything|{the_mission}]",
    "the_mission": "(it|that|this|the [whole] mission|the task|the search|the tour|the patrol|"
            "the errand|the job|your mission|your task|your search|your tour|your patrol|"
            "your rounds|your round|your errand|your job|your work|your way|mission|"
            "what i [just] said|(that|the|my) [last] (order|command|instruction|task|job|errand))",
    "quit": "((cancel|abort|kill|never mind|nevermind|quit|scrap|drop|give up|call off) [on] "
            "{task} [about (it|that)]|(leave|bin|forget) (it|that))",
    "reason": """
        [, [and] ((until|while|because|so) (i|we|he|she|they|it|someone|somebody|you hear) ...|
        for (me|us|him|her|them)|until (further notice|then)|then (go on|continue|carry on|
        keep going|resume)|(i|we|he|she|they|you) (am|are|is|will|have|has|just|need to|would|come|
        go|do not need|do not want) ...|wrong (one|order|room|place|thing|way)|there (is|are) ...|
        let <object> (through|past|by|pass|in|out))]
        """,
}  # fmt: skip

QUESTIONS = {
    "self": """
        where are (you|we) {now}
        where (am i|you are|is the robot) {now}
        {tell} where you are {now}
        [in] (what|which) (room|place) (are you|is this|are we|am i) [in] {now}
        what is your (position|location)
    """,
    "rooms": """
        (what|which) [other|kinds of] rooms {so_far}
        {tell} [me] (what|which|the|all the|your) rooms {so_far}
        (list|name) [me] [all|the|your|known]* rooms {so_far}
        [{tell}|find out] how many rooms {so_far}
    """,
    "places": """
        (what|which) places {so_far}
        {tell} [me] (what|which|the|all the|your) places {so_far}
        (list|name) [me] [all|the|your|known]* places {so_far}
    """,
    "doing": """
        what are you (doing|up to|working on|looking for|searching for|waiting for) {now}
        what is your [current] (mission|task|job|errand|goal|target|status|plan)
        {tell} what you are (doing|up to|looking for) {now}
        {tell} [me] [about] (your|the) [current] (mission|task|status|progress)
        [{tell}] how (is it|are you) (going|getting on|doing|coming along) [with ...]
        (are you|have you) (done|finished|ready|there|busy|stuck|lost) [yet|already|now]*
        [{tell}] why (did you stop|have you stopped|are you (not moving|standing still|waiting|
            standing [there|here]|stuck)|do you (not move|wait|stand [there|here]))
        (what|where) are you (going|heading|driving|headed) [to] [next|now]
        what (comes|is|will you do|do you do) next
        (did|have|can) you [already] (find|found|see|seen|reach|reached) (it|them|that) [yet|
            already]*
        when (are you|will you be) (back|done|finished|ready|there|home)
        how (much longer|long (will|does) (it|this|that) take|long (until|till) ...|far along ...)
    """,
    "help": """
        what (can|do) you do [for me|for us]
        (what|which) [kinds of] (commands|orders|things|sentences) (can|do) (you|i) (understand|
            know|do|say|ask|give)
        what can i (ask|tell|say|order) [you] [to do]
        how do (you work|i use you)
        help [me]
    """,
    "seen": """
        {tell} (what|which things|which objects|what things|what objects) [all|else] {you} [all|
            everything] {seen} {in} [out there|in there|there|with your camera|all]* {last}
        (what|which things|which objects) [all|else] [you have|you did|have you] {seen} {in} {last}
        (what|which things|what things|which objects) (is|was|are) [there] (in|inside) <room> {last}
        {tell} [me] (what|all|everything) [that|what] you [have|did|all]* {seen} {in} {last}
        (list|name) [me] (what|all|everything) [that] you [have|did]* {seen} {in} {last}
        (list|name) [me] [all|the|all the] (objects|things) [that you know] [(in|inside) <room>]
        what do you (know|remember) [about this place|so far]
        {anything} (in|inside) <room> {last}
        {anything} <relation> <anchor> {last}
        what can you see {in} {last}
        [{tell}] (what|which things|which objects) (is|are|was|were) [there|standing|lying|
            sitting]* <relation> <anchor> {last}
    """,
    "where": """
        {tell} (where|whereabouts) [exactly|on earth|in the world] (is|are|was|were|have|has|did|do|
            stands|lies|sits|it is|it was|they are) [it|they] [the (nearest|closest)] <object> [is|
            are|was|were] {last}
        {tell} where <object> (is|are|was|were|has|have) {last}
        {tell} where [exactly|last|did|have|had|has|do|would]* {you} {seen} [last] <object> {last}
        {tell} where [on earth|in the world|ever] [did|do|have|had] (i|we) [have|had|did] (put|
            leave|left|lost|forget|drop|dropped|keep|kept|store) <object> {last}
        {tell} where ((can|could|do|should|would|will|might) (i|we)|(i|we) (can|could)) (find|see|
            get|look for|go for) <object>
        {tell} [in] (which|what) (room|aisle|bay|ward|cupboard|drawer) [there] (is|are|was|
            were) <object> [in] {last}
        {tell} (which|what) (room|rooms) (has|have) <object> [in (it|them)] {last}
        {tell} where did <object> (go|end up|get to|go to)
        {tell} (which|what) (room|aisle|bay|ward|cupboard|drawer) <object> (is|are) in
        {tell} (when|how long ago) {you} {seen} <object> {last}
        {tell} [in] (which|what) room {you} {seen} <object> [in] {last}
        (i|we) [seem to] [have] (can not find|do not find|look for|search [for]|lost|mislaid|
            misplaced|am looking for|are looking for|miss) <object> , (where (is|are) (it|they)|
            (have|did) you (seen|see|noticed|notice|spotted|found) (it|them)) {last}
        {tell} the (place|location|position) of <object>
        do you know where [i|we] [can find|left|put] <object> [is|are] {last}
        [{tell}] how far [away] (is|are) [it|they] [from here] [to] <object> [from here|away]*
    """,
    "exists": """
        (can|could|do) you [still] see <object> {in} {last}
        {tell} {you} {seen} [any|of|already]* <object> {in} {last}
        (seen|spotted|noticed) [any|of|already]* <object> {in} {last}
        {tell} [is|was|are|were] there [still|really|already] <object> {in} {last}
        any <object> [left|still]* <relation> <anchor> {last}
        {tell} (if|whether) there (is|are) <object> {in} {last}
        (i|we) can not find <object> . {you} {seen} (it|them|one) {in} {last}
        (did|have|had) (i|we|someone|somebody) (leave|left|put|lost|forgotten|forget|drop|
            dropped) <object> {in} {last}
        do (we|you) (have|know [of|about]|remember) <object> {in} {last}
        [it] (exists|exist) [there] <object> {in} {last}
        (have (we|you)|you) got <object> {in} {last}
        {tell} (is|are|was|were) <object> [still|already|really] <relation> <anchor> [(in|
            inside) <within>] {last}
        {tell} (is|are) <object> [still|already|really|there|here|around]* {last}
        you have not {seen} [any|my]* <object> {in} {last}
        any (sign|trace) of <object> {in} {last}
        (does|do|has) <room> (have|got|contain) [any] <object> [(in|inside) it] {last}
    """,
    "count": """
        [{tell}] how many <object> {you} {seen} {in} {last}
        [{tell}] how many <object> are there {in} {last}
        [{tell}] how many <object> (do|have) (we|you) (have|got|know) {in} {last}
        [{tell}] how many <object> {you} count {in} {last}
        [{tell}] how many <object> (are|is) {in} {last}
        [{tell}] how many <object> there are {in} {last}
        [{tell}] how many <object> {in} {last}
    """,
}
"""Topic of `MemoryQuestion` → its templates."""

ORDERS = {
    "stay_inside": """
        [you|must|should|have to|only|just|always]* (stay|remain|keep|drive|move|be) [only|just|
            always]* (inside|in|within) ({this_room}|<room>) [only] {while}
        {not} (leave|leaving|go out of|going out of|go outside|go outside of|get out of|exit|
            drive out of) ({this_room}|<room>) {while}
    """,
    "keep_out": """
        [you|must|should|have to|need to|to|always|better]* {away} [of|from] <room> {while}
        [you|must|should|have to]* avoid [going|to go] [to|into|in|through] <room> {while}
        {not} {go} <room> {while}
        [to|for] you is (forbidden|prohibited|not allowed) <room> {while}
        no (robots|robot|entry|access|going) [in|into|to|inside|for robots]* <room> {while}
        (in|into|to|inside) <room> {not} (go|enter|drive|be|come) {while}
        <room> (is|are|has|have|was|were) ... ({away} [out] [of it|from it|of there|there]|
            {not} {go} [there|it|in there|in it|down there|inside]) {while}
        <room> (is|are) [now] (off limits|forbidden|out of bounds|closed|taboo|prohibited|
            not allowed|closed off|private|a no go zone|a no go area) [for you|to you|
            for robots] {while}
    """,
    "open": """
        it is [quite|perfectly|absolutely]* (okay|ok|fine|alright|all right|allowed|
            safe) [for you] [now|again]* to {go} <room> [again|now]*
        {may} {go} again [in|into|to]* <room> [now]
        {may} {go} <room> (again|freely|as before|as you like) [now|again]* {reason}
        [from now on|now]* {may} again {go} <room> [now]
        <room> (is|are) (open|free|allowed|accessible|okay|ok|available|fine|clear|
            permitted) [for you|to enter] again [for you|now]* [, (the|that|this) ban is (lifted|
            over|gone)]
        <room> (is|are) (open|free|okay|ok|fine|clear|clean|dry|empty|done|finished|ready) [again|
            now]* {may} [go|drive|come|enter|get|be|back]* [there|in there|in it|in|it|inside] again
        <room> (is|are) (no longer|not) (off limits|forbidden|closed) [for you|anymore|any more|
            now]*
        ... in <room> {may} [go|drive|come|enter|get|be|back]* (there|in there|in|inside) again
        {may} (leave|go out of|exit) ({this_room}|<room>) [again|now|anymore]*
        you (do not have|do not need) to (stay|keep) (out of|away from|in|inside) ({this_room}|
            <room>) (anymore|any more|any longer|now)
    """,
    "forget": """
        [you (can|may|could|should)] (forget|delete|remove|erase|unlearn|(scrap|drop) (the|
            this) name) [about] [the (place|room|zone|spot|name)] [called|named] <site> [from your
            (map|memory|list)|from the map|from memory|as a place|from (your|the) (places|list|
            memory|map)] {while}
        [you] (need not|do not have to|do not need to) (remember|know) [the (place|
            room)] <site> {while}
    """,
    "room": """
        ({this_room}|it|here|this|we|you) [here] (is|are|is called|are standing) [in|now|
            called]* <room>
        {keep} {this_room} [is|as] <name>
        {keep} , (this|here|we|you) [room] (is|are) [in] <room>
        {keep} {here} [is|as] [called|named] <room>
        {this_room} (is|is called|is named) <name>
        we call {here} <room>
    """,
    "place": """
        {keep} {here} [down] [is|as|to be|by the name] [called|named] <name>
        the name of {here} is <name>
        {keep} , {here} (is|is called) <name>
        {here} , {keep} it [as|like] <name>
        {keep} {here} [.|,|and]* (call|name) it <name>
        {here} (is called|is named|will be called|shall be called) <name>
        make {here} <name>
        (we|i) call {here} <name>
    """,
    "stated": """
        {here} (is|will be|shall be) [now|from now on] <name>
    """,
    "moved": """
        <name> (is|will be|shall be) [now|from now on] [in|at] {here}
    """,
}
"""`do` of `SiteOrder` → its templates."""

CONTROL = {
    "resume": """
        [[it] is (ok|okay|fine|good) [now]] , [you|robot|the robot] [can|may|should|could] [now|to|
            please]* (go on|carry on|crack on|press on|continue|resume|keep going|keep on|
            keep moving|keep driving|get moving|get going|go ahead|off you go|on you go|as you were|
            proceed|move on|drive on|start again|back to work|move again|go again|drive again|
            unpause) [now|then|again|please|with|as before|what you (were|was) doing [before]|
            where you left off|where you stopped|from where you stopped|doing that|driving|
            searching|looking]* {task}
        [you|robot|the robot] (can|may) [now] (move|drive) [now|again]
    """,
    "cancel": """
        {quit} [, {quit}]* [, you are (done|finished)|, wrong <object>|, (i|we) (need|
            want) you (elsewhere|here|somewhere else)]
        {quit} , (i|we) do not (need|want) (it|them|that|this) [any more|anymore|now]*
        do nothing (more|else|further)
        [you (can|may)] forget [about] [all of] {the_mission}
        [you (can|may|should)] (stop|end) (searching|looking|exploring|patrolling|the|your) [search|
            mission|task|patrol|tour|errand|rounds|job|for it]
    """,
    "again": """
        [please] [the same] (again|once more|one more time|once again) [please]
        [please] (try|do|repeat|run) [it|that|the same [thing]] (again|once more|one more time|
            once again) [please]
        [please] (try|do|repeat|run|start) the [last|same|previous] (mission|task|errand|tour|
            patrol|order) (again|once more|one more time|once again) [please]
        [please] (repeat|redo) [it|that|the [last|same|previous] (mission|task|errand|tour|patrol|
            order)] [please]
        [please] do the same [thing] [please]
    """,
    "pause": """
        [wait|hold on|hang on]* (a|one|half a) (moment|second|sec|tick) {there} {reason}
        (stop|halt|freeze|hold it|hold on|hold up|hold still|hold|pause|stand still|whoa|enough|
            do not move|stay (where you are|there|still|put|right there)|stop|hold your horses|
            not move|brake|keep still|you can stop|be still|stand there|emergency stop|not so fast|
            do not (go|drive|rush|run) (on|off|away|any further|further|anywhere)|remain (there|
            where you are)|stop it|stop that) {there} {reason}
        (pause|interrupt|suspend) {task} {there} [for a (bit|moment|second|sec|tick|
            while)] [for] [<span>]
        [make a|come to a] {halt} {there} [{halt} {there}]* {reason}
        (wait|stay|stop|do not move|stand|stand still|pause|remain|hold [on|up]|hang on|rest|park|
            sit tight|stand by|hold [your] position|stay put|hold it|give (me|us)|take a break|
            make a pause) [right here|right there|here|there|in here|in place|on the spot|
            where you are|for me|me|still|please|just|stop|in this (spot|place)|at this (spot|
            place)|exactly|for a (bit|moment|second|sec|tick|while)|a (bit|moment|second|sec|
            while)]* [for] [<span>] [here|there|please|now|more|longer|then]* {reason}
    """,
}
"""`do` of `Control` → its templates."""

IDIOMS = """
    [it|that] [is|makes] (all|no)* [the] (same|one|difference) [for me|for us|to me|to us]
    (no worries|no problem|no hurry|no rush|as you like|as you wish)
    do not (mind|worry about|bother about) (me|us|him|her|it|them)
    (i|we) [have] changed (my|our) mind
    you are doing (well|great|fine|good) ...
    you are [going to be] (a|an|the|my|our) <object> [now|today]
    <object> (are|is) (expecting|waiting for|looking for) (you|us|me) [there|now|already]
    (they|he|she) (are|is) (expecting|waiting for|looking for) (you|us|me) [there|now|already]
    (i|we) want to play [a game|<object>]
    let us play [a game|hide and seek|<object>]
    (i|we) need (one|it|them) [now|here|badly|urgently|today|soon]*
    [and|then|after that]* you are (done|finished|free)
    (that|this) is (quite|more than)* (enough|all|it) [for (now|today)]
    [it] does not matter [to me|to us] [which|which one]
    (i|we) do not (care|mind) (where|when|how|[about] [the] order)
    take your time
    (whichever|whatever) (order|sequence|way) (is|you find) [the] (shortest|fastest|quickest|best|
            easiest|you like)
    there is no (rush|hurry)
    [you are allowed to] (you|) (pick|choose|decide)
    [and] whichever you (please|like|prefer)
    [it] is all one to (me|us)
    (i|we) want to show you <object>
    thank (heavens|goodness|god)
    you have done [quite|more than]* (enough|well) [today|now|already]*
    (i|we) [do] not know where (it|he|she|they) (is|are|went|hides|hide|(has|have) gone)
    [the] (order|sequence) (does not matter|is (equal|up to you))
    (it|that|this) (is|was) [a|very|so|too|really|not|getting]* (secret|cold|dark|late|urgent|
            important|packed|crowded|slippery|occupied|full|raining|noisy|emergency|hot|wet|
            dangerous|there anymore|busy|there any more|loud|nap time|bedtime|fun) [now|today|
            again]*
    (you|it) (are|will|is|would) [going to|not] (run into|bump into|hit|crash|squash|break|hurt|
            scare|fall|knock|crush|wake|in the way|in my way|too (fast|loud|close)) ...
    [so|so that] you (know|learn|remember|will know|get to know) (what|who|where|your|the place|
            the house|this place) ...
    [for|in order] to (know|learn|get to know) (it|them|everything|the place|the house)
"""
"""Whole clauses that give no order."""
REMARKS = """
    [because|cause|since|as|so|and|while] (i|we|he|she|they|somebody|someone|people|(my|
            our) <object>) [have|has|had|am|are|is|was|were|will|can|could|just|only|always|really|
            still|already|do not|did not|can not|could not|have not|has not|think]* (am|is|are|was|
            were|have|has|had|got|just|heard|hear|lost|saw|see|left|tore|think|feel|know|finished|
            moved|do|did|mopped|cleaned|washed|forgot|get|thought|found|will|<done>) ...
    [because|cause|since|as|so|and] there (is|are|was|were) ...
    (because|cause|since|while) (i|we|he|she|they|somebody|someone|people) ...
    (because|cause|since) <object> (is|are|was|were|has|have|got) ...
    (because|cause|since) (it|that) (is|was|has|smells|looks) ...
    <object> [is|are] (coming|passing|going|backing) [through|past|by|up|out]
    [because|cause|since|as|so|and] <object> (is|are|was|were) [still|so|very|all|just|too|now|
            being|really|a bit|already]* (wet|dirty|asleep|sick|ill|tired|noisy|hot|cold|dark|busy|
            late|upset|scared|slippery|hungry|sad|happy|sleeping|working|eating|cooking|resting|
            waiting|here|over|starting|beginning|arriving|gone|full|packed|crowded) ...
    <object> (starts|begins|arrives|ends) [now|soon|today]*
    it (has|had) (got|been) ...
    thank you for ...
"""
"""Statements that give no order if no word of theirs directs the robot; see `remarks.is_remark`."""
ASSENTS = """
    (it|that|this) is (all right|alright|okay|ok|fine|safe) [now|again]*
    (all|everything) [is] (clear|good|fine|safe|quiet|over) [now|again]*
"""
"""Clauses that say nothing at the beginning; after an order, they may take it back."""
STATES = """
    [because|cause|since|as|so|and|now] (there|<object>) (am|is|are|was|were|has|have|just|will) ...
"""
"""Clauses that say how something is, which may not stand in an errand: "the bed is first"."""
