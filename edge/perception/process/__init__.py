"""Models in processes of their own. If one crashes, hangs or fills its memory, the robot goes on.

The protocol of a detector, between the service (`detection/process.py`, `link.py`) and the model
process (`serve_detector.py`):

 1. The service starts the program `edge.perception.serve_detector`. It writes one JSON object to
    its stdin: configuration, prompts, logging, and descriptors of two sockets and the frame file.
 2. The sockets, `images` and `control`, keep message boundaries (SOCK_SEQPACKET). While the
    process loads its model it sends {health} on control now and then. Once the model has run it
    sends {} there, or {error, text} if it failed.
 3. An image is in the frame file (`wire.py`): memory without a name on disk, which the service
    owns and alone writes. A sequence number is written before the pixels and again after them.
 4. On `images` the service sends {seq, hw, prompts}. The process reads the pixels in place and
    answers {seq, n, prompts, …}, a line end and one block of arrays, or {seq, error, text}. Here
    seq is the request's number, hw the image's height and width, and n the number of boxes.
 5. On `control` the service sends {id, prompts} to check prompts at once: the process answers
    {id} or {id, error, text}. The prompts of the next request on `images` take effect.
 6. Sizes, types and values of every answer are checked (`wire.py`); nothing is unpickled. One
    request is under way at a time. A process that does not answer within `timeout_s`, or answers
    nonsense, is killed. A process that ended is started again by the rules of
    `supervised.RestartBackoff`.
 7. SIGTERM ends the process, and the kernel ends it (PR_SET_PDEATHSIG) with its parent.

A model for VLM frontier selection (`scoring/choice/process.py`) gets its requests on `images`: a
language model {seq, hw, rules, view, asked, limit_s}, with hw null for a view in words; a network
for marks {seq, hw, marks, others, target, limit_s}. Here rules is the system message, and asked are
the questions with their possible answers. It answers {seq, p}, where p is the probabilities of the
answers. Its `control` socket carries no requests after the start. It runs at a low priority.
"""
