"""Parts that several templates of the module `errands` share; for the notation see `templates`."""

from __future__ import annotations

PARTS = {
    "then": "[, and|, then|, and then|, and after|, and afterwards|, so|, but] "
            "[you (must|have to|should|need to)]",
    "drive": """
        (go|drive|run|head|move|roll|walk|come|get|pop|nip|hurry|travel|return|hop|step|zip|swing|
        ride|rush|dash)
        """,
    "over": "[over|out|back|there|up|down|along|quickly|straight|right|in|again|yourself|on|then]*",
    "goes": "[{drive} {over} [and|to]]",
    "if": "(if|whether|that|is it true that|to see if|to see whether|and see if|and see whether|"
          "and tell me if|and tell me whether|for me if|for me whether|out if|out whether|"
          "and check if|and look if|quickly if|again if|again whether)",
    "check": """
        (check|see|look|look see|look and see|verify|find out|control|have a look|take a look|
        have a quick look|confirm|double check|peek|inspect|have a peek|take a peek|tell me|
        let me know)
        """,
    "still": "[still|really|actually|also|now|already|always]*",
    "at": "{still} [standing|lying|sitting|hanging|parked|placed] {still} "
          "[<relation> <anchor> [(in|inside) <within>]]",
    "whole": """
        (everything|everywhere|everything here|[in] [all] [of] [the|this|our|my|your|of|whole|
        entire|all|complete|every]* (house|home|flat|apartment|building|floor|area|place|ward|
        warehouse|surroundings|environment|rooms|site|room here|corner|store|department|
        neighbourhood)|all [what|that] is here|all around|all here|all over [the|this|place|house]*|
        the rest|everything [around|in] [here|there])
        """,
    "look": """
        (explore|explore (me|us)|exploring|inspect|tour|scout|scout out|scan|survey|map|map out|
        discover|investigate|get to know|[make|do] [an|the] exploration [of]|go exploring [in]|
        look through|search through|(look|drive|go|wander|roam|cruise|(have|take|make) a [good|
        quick] (look|wander|peek|tour)|do a (tour|scan)|make a map) [all] (around|round|about) [in|
        inside|of|at]|check [out|around|through]|(do|make|take) a [full|complete|quick|thorough|
        proper|good]* (round|tour|turn|lap|loop|sweep|scan|search) (of|through|around|in)|(look|
        search|(take|have|make) a look) [around] (in|inside))
        """,
    "time": "[, [only|for|during] <span> [long] [, no (longer|more)]] "
            "[again|once more|one more time|"
            "before (we|i|they) (start|begin|leave|open|close)]*",
    "until_told": """
        until ((i|we) (come|am|are|get|call|say|tell|give|ask|release|need|order|let)|(someone|
        somebody) (calls|says|tells|comes|asks)|you (hear|are told)) [me|us|you|back|home|here|
        there|so|stop|it|that|otherwise|done|ready|finished|again|for (me|you|it)|from (me|us)|
        a (sign|signal)|to (leave|go|move|come|stop|continue|go on|drive on)]*
        """,
    "where": "(at|in|by|near|near to|close to|inside|next to|in front of)",
    "patrol": """
        [keep|keep on|start|begin] [to] (patrol|patrolling|guard|[make|do] [a|the] patrol|
        going (round|around)|driving (round|around|between)|[go|be] on patrol|[do|doing|make|
        making] [your|the|some] rounds|go round|[go|drive|run|keep going|move|walk] back and forth|
        (do|run|drive|make) (laps|loops|circles|a (lap|loop|circle|circuit))|circle|loop|cycle|
        shuttle|alternate|(drive|go|run|move|walk) (around|round|up and down)|(go|drive|
        walk) between) [between|of|in|through|around|round|from|at|to|on]
        """,
    "patrolling": """
        [keep|keep on|start|begin] [to] (patrol|patrolling|[make|do] [a|the] patrol|[go|
        be] on patrol|shuttle|[go|drive|run|keep going|move|walk] back and forth) [between|of|in|
        through|around|round|from|at|to|on]
        """,
    "turn": "[(of|in) [the|this|our|my|your] (house|home|flat|apartment|building|place)] "
            "[, (one by one|in turn|one after (the other|another)|at least once)]",
    "house": "({patrolling}|guard) ({whole}|[the] rooms|<each>)",
    "rounds": "(times|rounds|laps|loops|circles|circuits|tours|turns|trips|round|lap|time)",
    "back": """
        [then|and|straight|right|directly|after|afterwards]* ( (come|go|get|drive|head|return|run|
        be|move|roll|bring yourself) [straight|right|directly] back|return|back) [to] [here|me|
        me here|us|this spot|this place|where (you|i|we) (are|am) now|where i am|your place here|
        again]* [here] [after|afterwards|after that|again]
        """,
    "home": """
        [the|your|to|from]* [(place|spot|point|position|location)] [, (where|from where|
        from which)] (you|we) [have|had|did|first]* (started|start|began|begin|set off|came|come|
        set out|left|departed) [from|out|off|at|in]*
        """,
    "hold": """
        (wait|stay|stop|remain|hold|hold on|pause|park|rest|hang on|stand still|stand|hang around|
        stay put|sit|sit down|make a (break|pause))
        """,
    "there": "[there|here|in there|in here|at that place|put|on the spot|for me|inside|still]*",
}  # fmt: skip
"""Name → template, for `{name}` in another template."""
