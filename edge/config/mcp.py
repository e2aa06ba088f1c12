"""The section of `edge mcp`: what agents may do through the Model Context Protocol."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from edge.config.section import Section


class McpConfig(Section):
    """Agents that use the robot by `edge mcp` (docs/mcp.md). Without this section, none can.

    Attributes:
        motion: orders of agents. `ask`: a person must allow each on the live page, or by a request
            to `confirm/request`. `allow`: they start at once, unless a mission of a person runs.
            `refuse`: agents only read, and stop the robot.
        confirm_s: an order expires if no person allows it within this time.
        calls_per_minute: limit of calls of one agent. Stops are not limited.
    """

    motion: Literal["ask", "allow", "refuse"] = "ask"
    confirm_s: Annotated[float, Field(gt=0, le=3600)] = 60.0
    calls_per_minute: Annotated[int, Field(ge=1, le=6000)] = 60
