"""A detector in a process of its own: it may crash, hang or run out of memory, the robot goes on.

The protocol, between the service (`detector.py`, `link.py`) and the model process (`serve.py`):

 1. The service starts the program `edge.perception.process.serve`, writes one JSON object to its
    stdin: configuration, prompts, a private folder, the frame file's descriptor (`messages.Start`).
 2. The process connects to two ZeroMQ PAIR sockets in that folder, `ipc://…/control` and
    `ipc://…/frames`. While it loads its model it says {health} on control now and then; when that
    has run once it says {} on both, else {error, text} on control. Then the folder is removed.
 3. An image lies in the frame file (`frames.py`): memory that the service owns and alone writes,
    with no name on disk; a sequence number is written before the pixels and again after them.
 4. On `frames` the service asks {seq, hw, prompts}. The process looks at the pixels where they lie
    and answers {seq, n, prompts, …} with one block of arrays, or {seq, error, text}.
 5. On `control` the service asks {id, prompts}, to hear at once whether they can be looked for:
    {id} or {id, error, text}. What counts is what the next request on `frames` says.
 6. Sizes, types and values of every answer are checked (`messages.py`); nothing is unpickled. One
    request is under way at a time: who does not answer it within `timeout_s`, or answers nonsense,
    is killed. A process that ended is started again by the rules in `restarts.py`.
 7. The process ends with SIGTERM, and the kernel ends it (PR_SET_PDEATHSIG) with its parent.
"""
