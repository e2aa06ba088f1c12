"""A model in a process of its own: it may crash, hang or run out of memory, the robot goes on.

The protocol of a detector, between the service (`detection/process.py`, `link.py`) and the model
process (`serve_detector.py`):

 1. The service starts the program `edge.perception.serve_detector`, writes one JSON object to its
    stdin: configuration, prompts, logging, and descriptors of two sockets and the frame file.
 2. The sockets, `images` and `control`, keep messages apart (SOCK_SEQPACKET). While it loads its
    model it says {health} on control now and then; when that has run once it says {} there, else
    {error, text}.
 3. An image lies in the frame file (`wire.py`): memory that the service owns and alone writes,
    with no name on disk; a sequence number is written before the pixels and again after them.
 4. On `images` the service asks {seq, hw, prompts}. The process looks at the pixels where they lie
    and answers {seq, n, prompts, …}, a line end and one block of arrays, or {seq, error, text}.
 5. On `control` the service asks {id, prompts}, to hear at once whether they can be looked for:
    {id} or {id, error, text}. What counts is what the next request on `images` says.
 6. Sizes, types and values of every answer are checked (`wire.py`); nothing is unpickled. One
    request is under way at a time: who does not answer it within `timeout_s`, or answers nonsense,
    is killed. A process that ended is started again by the rules of `kept.Restarts`.
 7. The process ends with SIGTERM, and the kernel ends it (PR_SET_PDEATHSIG) with its parent.

A model that chooses directions (`scoring/choice/process.py`) is asked on `images`: a language
model {seq, hw, rules, view, asked, limit_s}, where hw is null for a view in words, a network for
marks {seq, hw, marks, target, limit_s}; it answers {seq, p}. There is nothing to be asked on its
`control`; it gives way to whatever else runs.
"""
