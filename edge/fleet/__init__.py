"""Several robots over one router: who is there, who gets which mission, what becomes of it. All by
the requests that a single robot takes (`edge.bus.client`); what a robot does is not its business.
"""
