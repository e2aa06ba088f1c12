"""`edge mcp`: a server of the Model Context Protocol for agents; a client of the running service.

Needs the package `mcp` (extra `[mcp]`). `edge run` never imports it.
"""
