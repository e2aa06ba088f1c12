"""Tasks in free language and the trajectories that carry them out (OpenNav).

Perception builds a scene. A language model or the grammar rules write a coarse trajectory through
it. A value map refines this trajectory. Nothing here runs inside a tick, and nothing here drives.
"""
