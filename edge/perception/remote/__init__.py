"""Models that run on a server on another computer, spoken to in KServe's protocol, version 2.

Triton, MLServer, OpenVINO Model Server and KServe's own speak it. A server is believed nothing: its
answers are checked like a file from a stranger. What a model means is not known here.
"""
